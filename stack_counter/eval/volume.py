"""How well V and the container are measured, on noisy recordings of simulated scenes.

    stack-counter evaluate volume --set unseen
"""

from __future__ import annotations

import argparse
import json
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.eval.common.sets import folder_of
from stack_counter.pipeline import StackCounter
from stack_counter.sim import RECONSTRUCTED_KIND, Scene, read_scenes, record
from stack_counter.types import View

_HOLE_PX = 6  # side of a patch of missing depth


@dataclass(frozen=True)
class VolumeCase:
    """One scene: relative error of V and the same in standard deviations, errors of wall (m) and
    inner width (relative), NaN for heaps, whether the kind was found, and the seconds from the
    last view to V. All NaN if the scan was refused, with the reason."""

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


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `evaluate volume`."""
    parser.add_argument("--set", required=True, metavar="SET",
                        help="unseen, unseen-mixed or a folder of simulated scenes")
    parser.add_argument("--scenes", type=int, metavar="N", help="only the first N")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--missing", type=float, default=0.0, metavar="SHARE",
                        help="of the depth pixels, in patches")
    parser.add_argument("--pose-mm", type=float, default=0.5, metavar="X", help="pose noise")
    parser.add_argument("--pose-deg", type=float, default=0.05, metavar="X", help="pose noise")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the recordings")
    parser.add_argument("--workers", type=int, default=1, metavar="W")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures."""
    folder = folder_of(options.set)
    scenes = [s for s in read_scenes(folder, options.scenes) if s.truth.count]
    jobs = [(scene, options) for scene in scenes]
    if options.workers > 1:
        with ProcessPoolExecutor(options.workers) as pool:
            cases = list(tqdm(pool.map(_measured, jobs), total=len(jobs), unit=" scenes"))
    else:
        cases = [_measured(job) for job in tqdm(jobs, unit=" scenes")]
    print(f"{options.set}: {len(cases)} scenes, {options.views} views, seed {options.seed}, "
          f"{options.missing:.0%} of the depth missing, pose noise {options.pose_mm} mm and "
          f"{options.pose_deg} degrees")
    print(table(cases))
    if options.json:
        options.json.write_text(json.dumps([asdict(c) for c in cases], indent=1) + "\n")
    return 0


def _measured(job: tuple[Scene, argparse.Namespace]) -> VolumeCase:
    scene, options = job
    views = record(scene, options.views, options.seed, color=False,
                   pose_sigma_m=options.pose_mm / 1000, pose_sigma_deg=options.pose_deg)
    random = np.random.default_rng([options.seed, scene.index, 0x401E])
    if options.missing:
        views = [_with_holes(view, options.missing, random) for view in views]
    return measure(scene, views)


def _with_holes(view: View, share: float, random: np.random.Generator) -> View:
    assert view.depth is not None  # recordings have depth
    rows, cols = (n // _HOLE_PX + 1 for n in view.depth.shape)
    holes = np.kron(random.random((rows, cols)) < share, np.ones((_HOLE_PX, _HOLE_PX), bool))
    holes = holes[:view.depth.shape[0], :view.depth.shape[1]]
    return replace(view, depth=np.where(holes, 0, view.depth).astype(np.float32))


def measure(scene: Scene, views: list[View]) -> VolumeCase:
    """One scene through the pipeline, with the default settings."""
    stack, shape = StackCounter(ReconstructorConfig()), scene.container
    stack.start(scene.truth.unit_volume)
    try:
        for view in views:
            stack.add_view(view)
        volume = stack.volume()
    except ScanError as error:
        return VolumeCase(shape.kind, scene.index, refused=str(error))
    found = volume.container
    miss = volume.stack_volume - scene.truth.stack_volume
    case = VolumeCase(
        shape.kind, scene.index, miss / scene.truth.stack_volume,
        miss / volume.stack_volume_std if volume.stack_volume_std else np.nan,
        kind_found=found.kind == RECONSTRUCTED_KIND[shape.kind], finish_s=volume.seconds["finish"])
    if shape.kind == "none" or not case.kind_found:
        return case
    true, got = (sorted(sizes[:2]) for sizes in (shape.inner_size_m, found.inner_size_m))
    return replace(case, wall_error_m=found.wall_thickness_m - shape.wall_thickness_m,
                   wall_m=shape.wall_thickness_m,
                   width_error=float(np.mean(np.array(got) / np.array(true) - 1)))


def table(cases: list[VolumeCase]) -> str:
    """The figures by container kind."""
    lines = [f"{'':10}{'scenes':>7}{'refused':>8}{'found':>7}{'MAE':>8}{'bias':>8}{'p95':>8}"
             f"{'z std':>7}{'wall mm':>9}{'wall ok':>8}{'width':>8}{'finish s':>9}"]
    groups = {"all": cases, **{name: [c for c in cases if RECONSTRUCTED_KIND[c.kind] == name]
                               for name in ("box", "round", "free", "none")}}
    for name, group in groups.items():
        done = [c for c in group if not c.refused]
        if not done:
            continue
        e, z, wall, thick, width, s = np.array([
            (c.error, c.z, c.wall_error_m, c.wall_m, c.width_error, c.finish_s) for c in done]).T
        walled = np.isfinite(wall)
        fine = np.abs(wall[walled]) <= np.maximum(0.0015, 0.15 * thick[walled])
        lines.append(
            f"{name:10}{len(group):7}{len(group) - len(done):8}"
            f"{np.mean([c.kind_found for c in done]):7.0%}{np.abs(e).mean():8.3f}{e.mean():+8.3f}"
            f"{np.percentile(np.abs(e), 95):8.3f}{np.nanstd(z):7.2f}"
            + (f"{1000 * np.abs(wall[walled]).mean():9.2f}{fine.mean():8.0%}"
               f"{np.abs(width[walled]).mean():8.3f}" if walled.any() else " " * 25)
            + f"{np.median(s):9.2f}")
    return "\n".join(lines)
