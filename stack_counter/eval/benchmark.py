"""V and its cost beside the published rule's, on noisy recordings of simulated scenes.

    stack-counter evaluate benchmark --set data/unseen --scenes 10

What the rule measures and what it is given: `published_rule`. Its votes are counted here over
whole arrays; the released code loops over voxels, which is timed on some of them. Rendering the
rule's depth images (its authors optimise Gaussian splats for them) is not part of its time.
"""

from __future__ import annotations

import argparse
import json
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ConfigError, StackCounterError
from stack_counter.eval.common import cost
from stack_counter.eval.common.published_rule import (
    CELLS,
    RELEASED,
    WRITTEN,
    Grid,
    against_by_loop,
    volume,
)
from stack_counter.eval.common.sets import folder_of
from stack_counter.pipeline import StackCounter
from stack_counter.sim import Scene, read_scenes, record
from stack_counter.types import View

_LOOPED = 20_000  # voxels that the loop is timed on, in one view
_COSTED = 4  # scenes on which cost is measured


@dataclass(frozen=True)
class Row:
    """One scene: relative errors of V (ours NaN if a view or the scan was refused) and seconds."""

    kind: str
    index: int
    written: float
    released: float
    ours: float
    rule_s: float
    loop_s: float
    ours_s: float


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The command line of `evaluate benchmark`."""
    parser.add_argument("--set", required=True, metavar="SET",
                        help="unseen, unseen-mixed or a folder of simulated scenes")
    parser.add_argument("--scenes", type=int, default=10, metavar="N",
                        help="spread over the set (default 10)")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--seed", type=int, default=0, metavar="S", help="of the recordings")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write all figures here")


def run(args: argparse.Namespace) -> int:
    """Prints and writes the figures."""
    folder = folder_of(args.set)
    if args.views < 4 or args.scenes < 1:
        raise ConfigError(f"{args.scenes} scenes of {args.views} views; expected 1 or more of 4 "
                          "or more")
    scenes = [s for s in read_scenes(folder, 10 * args.scenes) if s.truth.count]
    scenes = [scenes[i] for i in sorted({*np.linspace(0, len(scenes) - 1, args.scenes,
                                                      dtype=int)})]
    rows: list[Row] = []
    kept: list[tuple[Scene, list[View]]] = []
    for scene in tqdm(scenes, unit=" scenes"):
        views = record(scene, args.views, args.seed, color=False, labels=True)
        rows.append(compare(scene, views))
        if len(kept) < _COSTED:
            kept.append((scene, [replace(view, labels=None) for view in views]))
    print(f"{args.set}: {len(rows)} scenes, {args.views} views, seed {args.seed}")
    print(table(rows), flush=True)  # cost takes minutes more
    figures = cost.measure(kept, args.seed)
    print(f"cost, {len(kept)} scenes:\n{cost.text(figures)}")
    if args.json:
        args.json.write_text(json.dumps({"scenes": [asdict(r) for r in rows], "cost": figures},
                                        indent=1) + "\n")
    return 0


def compare(scene: Scene, views: list[View]) -> Row:
    """The rule and our pipeline on the same views; `views` with true labels."""
    true, box = scene.truth.stack_volume, scene.container.mesh()
    corners = [mesh.vertices.astype(float) for mesh in (box, scene.parts_mesh()) if mesh]
    grid, wall = Grid.around(np.concatenate(corners)), scene.container.wall_thickness_m
    start = time.perf_counter()
    released = volume(views, grid, wall, RELEASED)
    rule_s = time.perf_counter() - start
    written = volume(views, grid, wall, WRITTEN)
    start = time.perf_counter()
    ours = _ours(views)
    ours_s = time.perf_counter() - start
    return Row(scene.container.kind, scene.index, written / true - 1, released / true - 1,
               ours / true - 1, rule_s, loop_seconds(views, grid), ours_s)


def _ours(views: list[View]) -> float:
    stack = StackCounter(ReconstructorConfig())
    try:
        for view in views:
            stack.add_view(replace(view, labels=None))
        return stack.volume().stack_volume
    except StackCounterError:
        return float("nan")


def loop_seconds(views: list[View], grid: Grid) -> float:
    """Of the loop over all voxels and views, from that over some voxels in one view."""
    some = grid.centers()[::max(CELLS**3 // _LOOPED, 1)]
    start = time.perf_counter()
    against_by_loop(views[0], some)
    return (time.perf_counter() - start) * grid.cells**3 / len(some) * len(views)


def table(rows: list[Row]) -> str:
    """Errors of V and seconds a scene, of the rule in both readings and of ours."""
    lines = [f"{'':28}{'refused':>8}{'MAE':>8}{'bias':>8}{'p95':>8}{'s/scene':>9}"]
    for name, errors, seconds in (("rule as the paper writes it", "written", "rule_s"),
                                  ("rule as released", "released", "rule_s"),
                                  ("rule as released, loop (*)", "released", "loop_s"),
                                  ("ours", "ours", "ours_s")):
        every = np.array([getattr(r, errors) for r in rows])
        e = every[np.isfinite(every)]
        if not len(e):
            continue
        lines.append(f"{name:28}{len(every) - len(e):8}{np.abs(e).mean():8.3f}{e.mean():+8.3f}"
                     f"{np.percentile(np.abs(e), 95):8.3f}"
                     f"{np.median([getattr(r, seconds) for r in rows]):9.2f}")
    return "\n".join([*lines, f"(*) extrapolated from {_LOOPED} voxels of one view"])
