"""How well the continuous mode follows a robot that takes parts out: one fixed camera, a view
after each pick.

    stack-counter evaluate live --set unseen --scenes 10
"""

from __future__ import annotations

import argparse
import json
import time
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import CounterConfig, ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.sets import folder_of
from stack_counter.occupancy.baselines import make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, read_scenes, record_fixed_camera, remove_parts

_CONFIDENCE = 0.9


@dataclass(frozen=True)
class Stamp:
    """After one view: the scene, the true count, that of one view before, what was said (None:
    no count), and the seconds from the view to the count."""

    scene: int
    kind: str
    true: int
    before: int
    count: int | None
    low: int
    high: int
    seconds: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line."""
    parser.add_argument("--set", required=True, metavar="SET",
                        help="unseen, unseen-mixed or a folder of simulated scenes")
    parser.add_argument("--scenes", type=int, default=10, metavar="N", help="the first N")
    parser.add_argument("--picks", type=int, default=20, metavar="K")
    parser.add_argument("--share", type=float, default=0.0, metavar="S",
                        help="take this share of the parts in K picks of several, not one each")
    parser.add_argument("--workers", type=int, default=1, metavar="W")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every stamp here")


def run(options: argparse.Namespace) -> int:
    """Prints the figures."""
    scenes = [s for s in read_scenes(folder_of(options.set), options.scenes) if s.truth.count]
    jobs = [(scene, options.picks, options.share) for scene in scenes]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        stamps = [stamp for scene in tqdm(pool.map(_packed, jobs), total=len(jobs),
                                          unit=" scenes") for stamp in scene]
    print(f"{options.set}: {len(scenes)} scenes, a fixed camera, {options.picks} picks\n"
          + table(stamps))
    if options.json:
        options.json.write_text(json.dumps([asdict(s) for s in stamps], indent=1) + "\n")
    return 0


def _packed(job: tuple) -> list[Stamp]:
    return follow(*job)


def follow(scene: Scene, picks: int, share: float = 0.0) -> list[Stamp]:
    """What is said after each view of a scene that is emptied from the top."""
    each = max(1, round(share * len(scene.poses) / picks))
    states = list(remove_parts(scene, min(picks * each, len(scene.poses) - 1)))[::each]
    stack = StackCounter(ReconstructorConfig(live=True), scene.truth.unit_volume)
    estimator = make_estimator(CounterConfig())
    stamps: list[Stamp] = []
    for state, view in zip(states, record_fixed_camera(states, color=False)):
        begin = time.perf_counter()
        true = len(state.poses)
        before = stamps[-1].true if stamps else true
        said: tuple = (None, 0, 0)
        try:
            stack.add_view(view)
            count = stack.count(Part(scene.truth.unit_volume), estimator, _CONFIDENCE)
            said = (count.count, *count.count_interval)
        except (ViewError, ScanError) as error:
            print(f"scene {scene.index}, {true} parts: {error}")
        stamps.append(Stamp(scene.index, scene.container.kind, true, before, *said,
                            time.perf_counter() - begin))
    return stamps


def table(stamps: list[Stamp]) -> str:
    """Shares of stamps whose interval holds the truth, or what it was one view before; how the
    count follows; seconds."""
    said = [s for s in stamps if s.count is not None]
    lines = [f"{len(stamps)} stamps, {len(stamps) - len(said)} without a count"]
    for title, of in (("all", said), *((kind, [s for s in said if s.kind == kind])
                                       for kind in sorted({s.kind for s in said}))):
        now = np.mean([s.low <= s.true <= s.high for s in of])
        late = np.mean([s.low <= s.true <= s.high or s.low <= s.before <= s.high for s in of])
        true, count = (np.array([getattr(s, name) for s in of], float)
                       for name in ("true", "count"))
        half = np.median([(s.high - s.low) / 2 / max(s.count or 1, 1) for s in of])
        lines.append(f"{title:10}{len(of):5}  in the interval {now:.0%} (or one view before "
                     f"{late:.0%}), NAE {metrics.nae(true, count):.3f}, half width {half:.0%}, "
                     f"taken {_taken(of):.2f} of the truth")
    seconds = [s.seconds for s in stamps]
    lines.append(f"view to count: median {np.median(seconds):.2f} s, 95% "
                 f"{np.quantile(seconds, 0.95):.2f} s")
    return "\n".join(lines)


def _taken(stamps: list[Stamp]) -> float:
    """By how much the counts fell from each scene's first to its last, over what was taken."""
    fell = taken = 0.0
    for scene in {s.scene for s in stamps}:
        of = [s for s in stamps if s.scene == scene]
        fell += ((of[0].count or 0) - (of[-1].count or 0)) * of[0].true / max(of[0].count or 1, 1)
        taken += of[0].true - of[-1].true
    return fell / max(taken, 1.0)
