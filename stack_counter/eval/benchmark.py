# SPDX-License-Identifier: Apache-2.0
"""V and its cost beside the published rule's, on noisy recordings of simulated scenes.

    stack-counter evaluate benchmark --set data/unseen --scenes 10

What the rule measures and what it is given: `published_rule`. Its votes are counted here over
whole arrays; the released code loops over voxels, which is timed on some of them. Rendering the
rule's depth images (its authors optimise Gaussian splats for them) is not part of its time.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ConfigError, StackCounterError
from stack_counter.eval.common import cost
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.published_rule import (
    CELLS,
    RELEASED,
    WRITTEN,
    Grid,
    removal_votes_by_loop,
    volume_by_rule,
)
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, record
from stack_counter.tasks.progress import progress
from stack_counter.types import View


@dataclass(frozen=True)
class BenchmarkSettings:
    """How much is measured; chosen.

    Attributes:
        looped_voxels: number of voxels that the loop is timed on, in one view.
        cost_scenes: number of scenes on which cost is measured.
    """

    looped_voxels: int = 20_000
    cost_scenes: int = 4


SETTINGS = BenchmarkSettings()


@dataclass(frozen=True)
class BenchmarkRow:
    """One scene.

    Attributes:
        kind, index: kind of the container, and number of the scene.
        written, released, ours: relative errors of V by both readings of the rule and by the
            pipeline (NaN if a view or the scan was refused).
        rule_s, loop_s, ours_s: seconds of the rule over arrays, of its loop, and of the pipeline.
    """

    kind: str
    index: int
    written: float
    released: float
    ours: float
    rule_s: float
    loop_s: float
    ours_s: float


def run(args: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    if args.views < 4 or args.scenes < 1:
        raise ConfigError(f"{args.scenes} scenes of {args.views} views; expected 1 or more of 4 "
                          "or more")
    # Scenes spread over the set
    scenes = read_filled_scenes(args.set, 10 * args.scenes)
    spread = sorted({*np.linspace(0, len(scenes) - 1, args.scenes, dtype=int)})
    # V of every scene; the first recordings are kept for the cost
    rows: list[BenchmarkRow] = []
    recordings: list[tuple[Scene, list[View]]] = []
    for scene in progress([scenes[i] for i in spread], "volumes", "scenes"):
        views = record(scene, args.views, args.seed, color=False, labels=True)
        rows.append(compare_volumes(scene, views))
        if len(recordings) < SETTINGS.cost_scenes:
            recordings.append((scene, [replace(view, labels=None) for view in views]))
    print(f"{args.set}: {len(rows)} scenes, {args.views} views, seed {args.seed}")
    print(format_table(rows), flush=True)  # cost takes minutes more
    figures = cost.measure_cost(recordings, args.seed)
    print(f"cost, {len(recordings)} scenes:\n{cost.format_cost(figures)}")
    if args.json:
        write_figures(args.json, {"scenes": rows, "cost": figures})
    return 0


def compare_volumes(scene: Scene, views: list[View]) -> BenchmarkRow:
    """Measures V by the rule and by the pipeline on the same views, which hold true labels."""
    container, true = scene.container.mesh(), scene.truth.stack_volume
    meshes = [mesh for mesh in (container, scene.parts_mesh()) if mesh]
    grid = Grid.around(np.concatenate([mesh.vertices.astype(float) for mesh in meshes]))
    wall_m = scene.container.wall_thickness_m
    released, rule_s = _timed(lambda: volume_by_rule(views, grid, wall_m, RELEASED))
    written = volume_by_rule(views, grid, wall_m, WRITTEN)
    ours, ours_s = _timed(lambda: _volume_by_pipeline(views))
    return BenchmarkRow(
        scene.container.kind, scene.index, written=written / true - 1,
        released=released / true - 1, ours=ours / true - 1, rule_s=rule_s,
        loop_s=extrapolate_loop_seconds(views, grid), ours_s=ours_s)


def _timed(measure: Callable[[], float]) -> tuple[float, float]:
    """The result of a measurement, and the seconds that it took."""
    start = time.perf_counter()
    result = measure()
    return result, time.perf_counter() - start


def _volume_by_pipeline(views: list[View]) -> float:
    """V, m3; NaN if a view or the scan is refused."""
    counter = StackCounter(ReconstructorConfig())
    try:
        for view in views:
            counter.add_view(replace(view, labels=None))
        return counter.volume().stack_volume
    except StackCounterError:
        return float("nan")


def extrapolate_loop_seconds(views: list[View], grid: Grid) -> float:
    """Seconds of the loop over all voxels and views, from those over some voxels in one view."""
    some = grid.centers()[::max(CELLS**3 // SETTINGS.looped_voxels, 1)]
    start = time.perf_counter()
    removal_votes_by_loop(views[0], some)
    return (time.perf_counter() - start) * grid.cells**3 / len(some) * len(views)


def format_table(rows: list[BenchmarkRow]) -> str:
    """Errors of V and seconds a scene, of the rule in both readings and of the pipeline."""
    lines = [f"{'':28}{'refused':>8}{'MAE':>8}{'bias':>8}{'p95':>8}{'s/scene':>9}"]
    for title, error_field, seconds_field in (
            ("rule as the paper writes it", "written", "rule_s"),
            ("rule as released", "released", "rule_s"),
            ("rule as released, loop (*)", "released", "loop_s"),
            ("ours", "ours", "ours_s")):
        every = np.array([getattr(r, error_field) for r in rows])
        errors = every[np.isfinite(every)]
        if not len(errors):
            continue
        seconds = np.median([getattr(r, seconds_field) for r in rows])
        lines.append(f"{title:28}{len(every) - len(errors):8}{np.abs(errors).mean():8.3f}"
                     f"{errors.mean():+8.3f}{np.percentile(np.abs(errors), 95):8.3f}"
                     f"{seconds:9.2f}")
    return "\n".join(
        [*lines, f"(*) extrapolated from {SETTINGS.looped_voxels} voxels of one view"]
    )
