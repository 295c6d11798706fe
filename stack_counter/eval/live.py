# SPDX-License-Identifier: Apache-2.0
"""How well the continuous mode follows a robot that takes parts out.

One camera, a view after each pick, through the gate that the collector has: a view that it takes
for a duplicate leaves the count as it was.

    stack-counter evaluate live --set unseen --scenes 10 --camera returning
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import CollectorConfig, CounterConfig, ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.occupancy import make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, record_fixed_camera, record_returning_camera, remove_parts
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.views.view_gate import ViewGate

_CONFIDENCE = 0.9
_CAMERAS = {"static": record_fixed_camera,
            "tf": lambda states: [replace(v, fixed=False) for v in record_fixed_camera(states)],
            "returning": record_returning_camera}


@dataclass(frozen=True)
class LiveCount:
    """The count after one view.

    Attributes:
        scene, kind: number of the scene, and kind of its container.
        true, before: true count at this view, and at the one before it.
        count: the estimated count; None if there is none.
        low, high: its interval.
        seconds: time from the view to the count.
    """

    scene: int
    kind: str
    true: int
    before: int
    count: int | None
    low: int
    high: int
    seconds: float


def run(options: argparse.Namespace) -> int:
    """Prints the figures; returns the exit code."""
    scenes = read_filled_scenes(options.set, options.scenes)
    jobs = [(scene, options.picks, options.share, options.camera) for scene in scenes]
    of_scenes = map_tasks(_count_job, jobs, Workers.of(options))
    counts = [count for of_scene in progress(of_scenes, "counts", "scenes", len(jobs))
              for count in of_scene]
    print(f"{options.set}: {len(scenes)} scenes, {options.camera} camera, {options.picks} picks\n"
          + format_table(counts))
    if options.json:
        write_figures(options.json, counts)
    return 0


def _count_job(job: tuple) -> list[LiveCount]:
    return count_while_picking(*job)


def count_while_picking(scene: Scene, picks: int, share: float = 0.0, camera: str = "static"
                        ) -> list[LiveCount]:
    """Counts after each view of a scene that is emptied from the top.

    Args:
        scene: full.
        picks: number of picks, with a view before and after each.
        share: share of the parts that goes with all of them; 0: one part each.
        camera: `static`, `tf` or `returning`.
    """
    parts_a_pick = max(1, round(share * len(scene.poses) / picks))
    taken = min(picks * parts_a_pick, len(scene.poses) - 1)
    states = list(remove_parts(scene, taken))[::parts_a_pick]
    counter = StackCounter(ReconstructorConfig(live=True), scene.truth.unit_volume)
    gate, estimator = ViewGate(CollectorConfig(mode="continuous")), make_estimator(CounterConfig())
    counts: list[LiveCount] = []
    estimated, low, high, before = None, 0, 0, len(scene.poses)
    for state, view in zip(states, _CAMERAS[camera](states)):
        start, true = time.perf_counter(), len(state.poses)
        try:
            gate.check(view)
            estimated, low, high = None, 0, 0
            counter.add_view(view)
            count = counter.count(Part(scene.truth.unit_volume), estimator, _CONFIDENCE)
            estimated, (low, high) = count.count, count.count_interval
        except (ViewError, ScanError) as error:
            print(f"scene {scene.index}, {true} parts: {error}")
        counts.append(LiveCount(scene.index, scene.container.kind, true, before, estimated, low,
                                high, time.perf_counter() - start))
        before = true
    return counts


def format_table(counts: list[LiveCount]) -> str:
    """Shares of counts whose interval holds the truth, or what it was one view before.

    How the count follows; seconds.
    """
    counted = [c for c in counts if c.count is not None]
    lines = [f"{len(counts)} stamps, {len(counts) - len(counted)} without a count",
             _format_line("all", counted)]
    lines += [_format_line(kind, [c for c in counted if c.kind == kind])
              for kind in sorted({c.kind for c in counted})]
    seconds = [c.seconds for c in counts]
    lines.append(f"view to count: median {np.median(seconds):.2f} s, 95% "
                 f"{np.quantile(seconds, 0.95):.2f} s")
    return "\n".join(lines)


def _format_line(title: str, counts: list[LiveCount]) -> str:
    hits = np.mean([c.low <= c.true <= c.high for c in counts])
    late_hits = np.mean([c.low <= c.true <= c.high or c.low <= c.before <= c.high
                         for c in counts])
    true, guess = (np.array([getattr(c, name) for c in counts], float)
                   for name in ("true", "count"))
    half_width = np.median([(c.high - c.low) / 2 / max(c.count or 1, 1) for c in counts])
    return (f"{title:10}{len(counts):5}  in the interval {hits:.0%} (or one view before "
            f"{late_hits:.0%}), NAE {metrics.nae(true, guess):.3f}, half width {half_width:.0%}, "
            f"taken {_followed_share(counts):.2f} of the truth")


def _followed_share(counts: list[LiveCount]) -> float:
    """By how much the counts fell from each scene's first to its last, over what was taken."""
    fell = taken = 0.0
    for scene in {c.scene for c in counts}:
        of_scene = [c for c in counts if c.scene == scene]
        first, last = of_scene[0], of_scene[-1]
        fell += ((first.count or 0) - (last.count or 0)) * first.true / max(first.count or 1, 1)
        taken += first.true - last.true
    return fell / max(taken, 1.0)
