# SPDX-License-Identifier: Apache-2.0
"""How much of the parts' shape survives stereo, on simulated pictures without depth.

The gamma-network reads how rough the surface is at the scale of a part: beside the errors of the
depth stands the power spectrum of the height map, octave by octave, over that of the true surface.

stack-counter evaluate surface --set data/train-deep --scenes 3 --width 1280
"""

from __future__ import annotations

import argparse
import itertools
import time
from dataclasses import dataclass, replace

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.eval.common.band_power import EDGES, BandPower, band_powers
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.multiview.scan import scale_down
from stack_counter.reconstruction import PictureReconstruction
from stack_counter.sim import (
    DepthCamera,
    RayCaster,
    Scene,
    read_scenes,
    record,
    scaled_camera,
)
from stack_counter.tasks.progress import progress, write_line
from stack_counter.types import PARTS, HeightMap, View

_IDEAL = DepthCamera(sigma_m=0.0, sigma_per_m2=0.0, step_m=1e-6)


@dataclass(frozen=True)
class SurfaceCase:
    """One scene that stereo measured.

    Attributes:
        index, kind: number of the scene, and kind of its container.
        part_px: part lengths in the pictures as taken, pixels.
        volume_error: relative error of V.
        median_m, p90_m: median and 90th percentile of the depth's absolute error, metres.
        holes: share of the pixels of parts without depth.
        bands: power of the height map by octave, see `EDGES`.
        cpu_s: time of the processor, of all threads, seconds.
    """

    index: int
    kind: str
    part_px: float
    volume_error: float
    median_m: float
    p90_m: float
    holes: float
    bands: list[BandPower]
    cpu_s: float


def run(args: argparse.Namespace) -> int:
    """Records, measures and prints; returns the exit code."""
    cases = []
    print(f"octaves between waves of {', '.join(f'{edge:g}' for edge in EDGES)} part lengths: "
          "power over the true power (share of the true amplitude that is kept)")
    scenes = itertools.islice(read_scenes(find_set_folder(args.set)), args.first, None)
    for scene in progress(itertools.islice(scenes, args.scenes), "surfaces", "scenes",
                          args.scenes):
        views = record(scene, args.views, args.seed, camera=_IDEAL, labels=True,
                       intrinsics=scaled_camera(args.width))
        case = measure_surface(scene, views)
        if case is None:
            write_line(f"scene {scene.index}: stereo gave no depth")
            continue
        cases.append(case)
        write_line(format_case(case))
    if args.json:
        write_figures(args.json, cases)
    return 0


def measure_surface(scene: Scene, views: list[View]) -> SurfaceCase | None:
    """Measures a recording with ideal depth by its pictures and labels; None without stereo."""
    start = time.process_time()
    scan = PictureReconstruction(ReconstructorConfig(), scene.truth.unit_volume)
    for view in views:
        scan.add_view(replace(view, depth=None))
    volume = scan.measure_volume(taught=None)
    cpu_s = time.process_time() - start
    if scan.stereo is None or volume.top is None:
        return None
    # Errors of depth, at the size that stereo worked on
    errors = []
    for view, true in zip(scan.stereo.views, views):
        true = scale_down(true, true.intrinsics.width // view.intrinsics.width)
        assert view.depth is not None and true.depth is not None  # for the type checker
        parts = (true.labels == PARTS) & (true.depth > 0)
        errors.append(np.where(view.depth > 0, view.depth - true.depth, np.nan)[parts])
    error = np.abs(np.concatenate(errors))
    median, p90 = np.nanpercentile(error, [50, 90])
    part_length = scene.truth.unit_volume ** (1 / 3)
    distances = [np.median(view.depth[view.labels == PARTS]) for view in views
                 if view.depth is not None and np.any(view.labels == PARTS)]
    return SurfaceCase(
        scene.index, scene.container.kind,
        part_length * views[0].intrinsics.fx / float(np.median(distances)),
        volume.stack_volume / scene.truth.stack_volume - 1, float(median), float(p90),
        float(np.mean(~np.isfinite(error))),
        band_powers(volume.top.heights, true_heights(scene, volume.top), volume.top.pitch,
                    part_length), cpu_s)


def true_heights(scene: Scene, measured: HeightMap) -> np.ndarray:
    """(rows, cols) true heights at the cells of a map, metres, NaN beside the stack."""
    rows, cols = measured.heights.shape
    x, y = np.meshgrid((np.arange(cols) + 0.5) * measured.pitch,
                       (np.arange(rows) + 0.5) * measured.pitch)
    xy = geometry.apply(measured.T_world_map, np.stack([x, y, 0 * x], axis=-1))[..., :2]
    top = RayCaster(scene.parts_mesh()).surface_heights(xy)
    inner_mesh = scene.container.inner_mesh()
    if inner_mesh is None:
        return np.where(np.isfinite(top), top, np.nan)
    inner = RayCaster(inner_mesh).surface_heights(xy)
    return np.where(np.isfinite(inner), np.maximum(top, inner), np.nan)


def format_case(case: SurfaceCase) -> str:
    """The figures of one scene in a line."""
    bands = ", ".join(f"{band.measured / band.true:.2f} ({band.kept:.2f})" for band in case.bands)
    return (f"scene {case.index} {case.kind}, {case.part_px:.0f} px a part: V "
            f"{case.volume_error:+.1%}; depth off by {1e3 * case.median_m:.2f} mm, 90% within "
            f"{1e3 * case.p90_m:.1f}, {case.holes:.0%} holes; power {bands}; "
            f"{case.cpu_s:.0f} CPU-s")
