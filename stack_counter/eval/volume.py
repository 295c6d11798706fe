# SPDX-License-Identifier: Apache-2.0
"""How well V and the container are measured, on noisy recordings of simulated scenes.

stack-counter evaluate volume --set unseen
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.pipeline import StackCounter
from stack_counter.sim import RECONSTRUCTED_KIND, Scene, record
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import View

# Side of a patch of missing depth, pixels; a wall's thickness is right within so many metres or
# that share of it. Chosen.
_HOLE_PX, _WALL_TOLERANCE_M, _WALL_TOLERANCE = 6, 0.0015, 0.15


@dataclass(frozen=True)
class VolumeCase:
    """One scene; errors are NaN if the scan was refused, those of the container for heaps too.

    Attributes:
        kind, index: kind of the simulated container, and number of the scene.
        error, z: relative error of V, and the same in standard deviations.
        wall_error_m, wall_m: error of the wall's thickness, and the true thickness.
        width_error: relative error of the inner width.
        kind_found: the container's kind was found.
        finish_s: seconds from the last view to V.
        refused: why the scan was refused; empty if it was not.
    """

    kind: str
    index: int
    error: float = np.nan
    z: float = np.nan
    wall_error_m: float = np.nan
    wall_m: float = np.nan
    width_error: float = np.nan
    kind_found: bool = False
    finish_s: float = np.nan
    refused: str = ""


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    jobs = [(scene, options) for scene in read_filled_scenes(options.set, options.scenes)]
    cases = list(progress(map_tasks(_measure_recording, jobs, Workers.of(options)), "volumes",
                          "scenes", len(jobs)))
    print(f"{options.set}: {len(cases)} scenes, {options.views} views, seed {options.seed}, "
          f"{options.missing:.0%} of the depth missing, pose noise {options.pose_mm} mm and "
          f"{options.pose_deg} degrees")
    print(format_table(cases))
    if options.json:
        write_figures(options.json, cases)
    return 0


def _measure_recording(job: tuple[Scene, argparse.Namespace]) -> VolumeCase:
    """Records a scene as the options say, and measures it."""
    scene, options = job
    views = record(scene, options.views, options.seed, color=False,
                   pose_sigma_m=options.pose_mm / 1000, pose_sigma_deg=options.pose_deg)
    random = np.random.default_rng([options.seed, scene.index, 0x401E])
    if options.missing:
        views = [_with_holes(view, options.missing, random) for view in views]
    return measure_volume(scene, views)


def _with_holes(view: View, share: float, random: np.random.Generator) -> View:
    """The view without a share of its depth, which is missing in square patches."""
    assert view.depth is not None  # recordings have depth
    rows, cols = (n // _HOLE_PX + 1 for n in view.depth.shape)
    holes = np.kron(random.random((rows, cols)) < share, np.ones((_HOLE_PX, _HOLE_PX), bool))
    holes = holes[:view.depth.shape[0], :view.depth.shape[1]]
    return replace(view, depth=np.where(holes, 0, view.depth).astype(np.float32))


def measure_volume(scene: Scene, views: list[View]) -> VolumeCase:
    """Measures one scene through the pipeline, with the default settings."""
    shape = scene.container
    counter = StackCounter(ReconstructorConfig(), scene.truth.unit_volume)
    try:
        for view in views:
            counter.add_view(view)
        volume = counter.volume()
    except ScanError as error:
        return VolumeCase(shape.kind, scene.index, refused=str(error))
    # V, and whether the kind of the container was found
    found = volume.container
    difference = volume.stack_volume - scene.truth.stack_volume
    case = VolumeCase(
        shape.kind, scene.index, error=difference / scene.truth.stack_volume,
        z=difference / volume.stack_volume_std if volume.stack_volume_std else np.nan,
        kind_found=found.kind == RECONSTRUCTED_KIND[shape.kind], finish_s=volume.seconds["finish"])
    if shape.kind == "none" or not case.kind_found:
        return case
    # Walls and inner width
    true, measured = (sorted(sizes[:2]) for sizes in (shape.inner_size_m, found.inner_size_m))
    return replace(case, wall_error_m=found.wall_thickness_m - shape.wall_thickness_m,
                   wall_m=shape.wall_thickness_m,
                   width_error=float(np.mean(np.array(measured) / np.array(true) - 1)))


def format_table(cases: list[VolumeCase]) -> str:
    """The figures, of all scenes and by the kind of container that should be found."""
    lines = [f"{'':10}{'scenes':>7}{'refused':>8}{'found':>7}{'MAE':>8}{'bias':>8}{'p95':>8}"
             f"{'z std':>7}{'wall mm':>9}{'wall ok':>8}{'width':>8}{'finish s':>9}"]
    groups = {"all": cases, **{name: [c for c in cases if RECONSTRUCTED_KIND[c.kind] == name]
                               for name in ("box", "round", "free", "none")}}
    return "\n".join(lines + [_format_line(name, group) for name, group in groups.items()
                              if any(not c.refused for c in group)])


def _format_line(title: str, cases: list[VolumeCase]) -> str:
    done = [c for c in cases if not c.refused]
    error, z, wall_error, wall, width_error, finish = np.array([
        (c.error, c.z, c.wall_error_m, c.wall_m, c.width_error, c.finish_s) for c in done]).T
    # Containers whose kind was found
    walled = np.isfinite(wall_error)
    wall_error, wall, width_error = wall_error[walled], wall[walled], width_error[walled]
    right = np.abs(wall_error) <= np.maximum(_WALL_TOLERANCE_M, _WALL_TOLERANCE * wall)
    container = f"{1000 * np.abs(wall_error).mean():9.2f}{right.mean():8.0%}" \
                f"{np.abs(width_error).mean():8.3f}" if walled.any() else " " * 25
    return (f"{title:10}{len(cases):7}{len(cases) - len(done):8}"
            f"{np.mean([c.kind_found for c in done]):7.0%}{np.abs(error).mean():8.3f}"
            f"{error.mean():+8.3f}{np.percentile(np.abs(error), 95):8.3f}{np.nanstd(z):7.2f}"
            f"{container}{np.median(finish):9.2f}")
