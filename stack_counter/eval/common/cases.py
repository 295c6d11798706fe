"""Scenes of a set through the pipeline and several estimators, once for all figures."""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass
from functools import cache
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import CounterConfig
from stack_counter.counting import make_count
from stack_counter.errors import ScanError, ViewError
from stack_counter.eval.common.plot import plot_complexity
from stack_counter.eval.common.sets import folder_of
from stack_counter.occupancy.baselines import OccupancyEstimator, make_estimator
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.sim import Scene, ideal_surface, read_scenes, reconstruct
from stack_counter.types import Container, HeightMap, Reason, StackVolume, ViewTally

ROWS = {"Mean": "prior", "DepthExtrapolated": "depth_extrapolated",
        "DepthCorrected": "depth_corrected", "direct count": "direct", "ours": "network"}
_SEED = 0


@dataclass(frozen=True)
class Guess:
    """What one estimator says of a scene: gamma, count, its interval, seconds and reasons."""

    gamma: float
    count: int
    low: int
    high: int
    seconds: float
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class Case:
    """One scene: truth, V's relative error, and what each row of `ROWS` says."""

    index: int
    family: str
    kind: str
    count: int
    gamma: float
    fill: float
    complexity: float
    volume_error: float
    guesses: dict[str, Guess]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """What `evaluate gamma` and `evaluate count` take alike."""
    parser.add_argument("--set", required=True, metavar="SET",
                        help="unseen, unseen-mixed or a folder of simulated scenes")
    parser.add_argument("--scenes", type=int, metavar="N", help="only the first N")
    parser.add_argument("--depth", choices=("ideal", "noisy"), default="noisy",
                        help="noisy: recordings through the pipeline; ideal: true V and surface")
    parser.add_argument("--views", type=int, default=12, metavar="N", help="of each recording")
    parser.add_argument("--confidence", type=float, default=0.9, metavar="P")
    parser.add_argument("--weights", type=Path, metavar="PATH", help="of the network")
    parser.add_argument("--workers", type=int, default=1, metavar="W")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every scene here")
    parser.add_argument("--plot", type=Path, metavar="PNG",
                        help="draw gamma's error over the parts' complexity here")


def report(options: argparse.Namespace, of: str, table: Callable[[list[Case]], str]) -> int:
    """Measures, prints the table and writes the cases."""
    cases = measure(options)
    print(f"{options.set}: {of} of {len(cases)} scenes, {options.depth} depth")
    print(table(cases))
    if options.json:
        options.json.write_text(json.dumps([asdict(c) for c in cases], indent=1) + "\n")
    if options.plot:
        plot_complexity(cases, f"{options.set}, {options.depth} depth", options.plot)
    return 0


def measure(options: argparse.Namespace) -> list[Case]:
    """All scenes of the set that hold parts."""
    scenes = [s for s in read_scenes(folder_of(options.set), options.scenes) if s.truth.count]
    jobs = [(scene, options.depth, options.views, options.confidence, options.weights)
            for scene in scenes]
    if options.workers == 1:
        return [_case(*job) for job in tqdm(jobs, unit=" scenes")]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        return list(tqdm(pool.map(_packed, jobs), total=len(jobs), unit=" scenes"))


def _packed(job: tuple) -> Case:
    return _case(*job)


@cache
def _estimator(name: str, weights: Path | None) -> OccupancyEstimator:
    return make_estimator(CounterConfig(
        estimator=name, weights=str(weights) if weights and name == "network" else ""))


def _case(scene: Scene, depth: str, views: int, confidence: float, weights: Path | None) -> Case:
    truth, guesses, error = scene.truth, {}, np.nan
    try:
        volume = ideal(scene) if depth == "ideal" else reconstruct(scene, _SEED, views)
        error = volume.stack_volume / truth.stack_volume - 1
        for row, name in ROWS.items():
            guesses[row] = _guess(_estimator(name, weights), volume, truth.unit_volume,
                                  confidence)
    except (ScanError, ViewError) as refused:
        print(f"scene {scene.index}: {refused}")
        guesses = {}
    return Case(scene.index, scene.shape.family, scene.container.kind, truth.count, truth.gamma,
                truth.fill, scene.shape.complexity, error, guesses)


def _guess(estimator: OccupancyEstimator, volume: StackVolume, unit_volume: float,
           confidence: float) -> Guess:
    begin = time.perf_counter()
    estimate = estimator.estimate(volume, unit_volume)
    count = make_count(volume, unit_volume, estimate, confidence)
    return Guess(estimate.gamma, count.count, *count.count_interval,
                 time.perf_counter() - begin, estimate.reasons)


def ideal(scene: Scene) -> StackVolume:
    """What a perfect reconstruction would give: the true V and the surface as cast."""
    surface = ideal_surface(scene)
    length = scene.truth.unit_volume ** (1 / 3)
    maps = [HeightMap(np.eye(4), length / PIXELS_PER_LENGTH,
                      np.where(surface.valid, a * length, np.nan).astype(np.float32))
            for a in (surface.top, surface.inner)]
    container = Container("none" if scene.container.kind == "none" else "box", np.eye(4))
    return StackVolume(0, scene.truth.stack_volume, 0.0, container, (0, 0, 0), 1.0, *maps, None,
                       ViewTally())


def groups(cases: list[Case]) -> dict[str, list[Case]]:
    """By container kind, fill and complexity."""
    cuts = np.quantile([c.complexity for c in cases], [1 / 3, 2 / 3])
    out = {}
    for kind in sorted({c.kind for c in cases}):
        out[kind] = [c for c in cases if c.kind == kind]
    for low, high in ((0.0, 0.25), (0.25, 0.6), (0.6, 9.0)):
        out[f"fill {low:g}-{high:g}"] = [c for c in cases if low <= c.fill < high]
    for i, name in enumerate(("simple", "middling", "complex")):
        out[name] = [c for c in cases if np.searchsorted(cuts, c.complexity) == i]
    return {name: group for name, group in out.items() if group}
