"""What knowing the part brings: v only, its CAD file, one counted bin, both.

    stack-counter evaluate parts --set unseen-rigs --workers 2

Each rig of the set is one part in one container with one friction, which nothing is told of. Its
CAD row is `part add` with all defaults or, with `--container`, with the rig's container in the
settings. Every scan is counted by each of the others of its rig in turn; the errors of those are
averaged.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from tqdm import tqdm

from stack_counter.config import Config, CounterConfig, ReconstructorConfig
from stack_counter.errors import StackCounterError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.occupancy.baselines import OccupancyEstimator, make_estimator
from stack_counter.parts.calibration import calibrate
from stack_counter.parts.catalogue import Part
from stack_counter.parts.gamma_model import PartModels, Reading
from stack_counter.pipeline import count_stack
from stack_counter.sim import RECONSTRUCTED_KIND, SCENES_PER_RIG, Scene, read_scenes, reconstruct
from stack_counter.teaching import (
    Pile,
    PileScan,
    fit_part_models,
    make_pile_request,
    simulate_part_piles,
)
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

ROWS = ("v only", "CAD", "one counted scan", "CAD and one counted scan", "three counted scans",
        "CAD and three counted scans")
_SEED = 0


@dataclass(frozen=True)
class PartCount:
    """One count of one scan."""

    row: str
    rig: int
    scan: int
    true: int
    count: int
    low: int
    high: int
    estimator_share: float
    reasons: tuple[Reason, ...]


@dataclass(frozen=True)
class Rig:
    """A part, where it lies, and its scans: a volume and the true count of each."""

    number: int
    family: str
    seed: int
    kind: str
    friction: float
    scenes: list[Scene]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of `evaluate parts`."""
    parser.add_argument("--set", default="unseen-rigs", metavar="SET",
                        help="unseen-rigs or a folder of scenes of `simulate --plan rig`")
    parser.add_argument("--rigs", type=int, metavar="N", help="only the first N")
    parser.add_argument("--piles", type=int, default=64, metavar="N", help="of `part add`")
    parser.add_argument("--container", action="store_true",
                        help="`part add` is told the kind and inner size of each rig's container")
    parser.add_argument("--confidence", type=float, default=0.9, metavar="P")
    parser.add_argument("--workers", type=int, default=1, metavar="W")
    parser.add_argument("--cache", type=Path, default=Path("out/part-piles"), metavar="DIR",
                        help="where simulated piles are kept: a run resumes"
                             " (default out/part-piles)")
    parser.add_argument("--json", type=Path, metavar="OUT", help="write every count here")


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures."""
    rigs = group_by_rig(list(read_scenes(find_set_folder(options.set))))[:options.rigs]
    options.cache.mkdir(parents=True, exist_ok=True)
    models = {rig.number: _models(rig, options) for rig in tqdm(rigs, desc="part add")}
    scenes = [scene for rig in rigs for scene in rig.scenes]
    with ProcessPoolExecutor(options.workers, mp_context=get_context("spawn")) as pool:
        volumes = dict(zip((s.index for s in scenes), tqdm(
            pool.map(_volume, scenes), total=len(scenes), desc="scans", unit=" scans")))
    estimator, answers = CachedEstimator(make_estimator(CounterConfig())), []
    for rig in tqdm(rigs, desc="counts", unit=" rigs"):
        scans = [(s, v) for s in rig.scenes if (v := volumes[s.index]) is not None]
        answers += count_all_ways(rig, scans, models[rig.number], estimator, options.confidence)
    print(format_table(rigs, answers, sum(v is None for v in volumes.values())))
    print(format_sensitivity(list(models.values())))
    if options.json:
        options.json.write_text(json.dumps([asdict(a) for a in answers], indent=1) + "\n")
    return 0


def group_by_rig(scenes: list[Scene]) -> list[Rig]:
    """Scenes by rig; those of another part than the first are left out."""
    rigs: dict[int, Rig] = {}
    for s in scenes:
        number = s.index // SCENES_PER_RIG
        rig = rigs.setdefault(number, Rig(number, s.shape.family, s.shape.seed, s.container.kind,
                                          s.friction, []))
        if (s.shape.family, s.shape.seed) == (rig.family, rig.seed):
            rig.scenes.append(s)
    return list(rigs.values())


class CachedEstimator:
    """An estimator that says the same of the same scan, at once."""

    def __init__(self, estimator: OccupancyEstimator):
        self.name, self._estimator = estimator.name, estimator
        self._said: dict[tuple[int, float], OccupancyEstimate] = {}

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """See `OccupancyEstimator`; volumes must live as long as this does."""
        key = (id(volume), unit_volume)
        if key not in self._said:
            self._said[key] = self._estimator.estimate(volume, unit_volume)
        return self._said[key]


def _models(rig: Rig, options: argparse.Namespace) -> PartModels:
    """What `part add` learns, from piles kept in the cache."""
    shape, container = rig.scenes[0].shape, rig.scenes[0].container
    config = (
        Config()
        if not options.container
        else Config(
            reconstructor=ReconstructorConfig(
                container_kind=RECONSTRUCTED_KIND[container.kind],
                container_inner_size_m=container.inner_size_m,
            )
        )
    )
    order = make_pile_request(shape.vertices, shape.faces, config)
    heard = make_estimator(order.estimator).name
    rig_of = f"-rig{rig.number}" if options.container else ""
    name = f"{rig.family}-{rig.seed}-{options.piles}{rig_of}-{heard}.json".replace(" ", "-")
    path = options.cache / name
    if not path.exists():
        piles = simulate_part_piles(order, options.piles, options.workers, lambda: None)
        path.write_text(json.dumps([asdict(pile) for pile in piles]) + "\n")
    kept = [Pile(*(None if seen is None else PileScan(**{**seen, "reading": Reading(
        **seen["reading"])}) for seen in pile.values())) for pile in json.loads(path.read_text())]
    return fit_part_models(order, kept, heard)


def _volume(scene: Scene) -> StackVolume | None:
    try:
        return replace(reconstruct(scene, _SEED), mesh=None)
    except StackCounterError as error:
        print(f"scene {scene.index}: {error}")
        return None


def count_all_ways(rig: Rig, scans: list[tuple[Scene, StackVolume]], models: PartModels,
               estimator: OccupancyEstimator, confidence: float) -> list[PartCount]:
    """All rows for all scans of a rig."""
    bare = Part(rig.scenes[0].truth.unit_volume, "part")
    counted = [calibrate(bare, volume, scene.truth.count, estimator, str(scene.index),
                            confidence, force=True).scan for scene, volume in scans]
    out = []
    for i, (scene, volume) in enumerate(scans):
        def say(row: str, part: Part) -> None:
            c = count_stack(volume, part, estimator, confidence)  # noqa: B023
            out.append(PartCount(row, rig.number, scene.index, scene.truth.count,  # noqa: B023
                              c.count, *c.count_interval, c.gamma_shares["estimator"],
                              c.reasons))

        others = [c for k, c in enumerate(counted) if k != i]
        cad = _PartWithModels(bare.unit_volume, "part", said=models)
        say("v only", bare)
        say("CAD", cad)
        for k, one in enumerate(others):
            three = tuple(others[(k + j) % len(others)] for j in range(3))
            say("one counted scan", replace(bare, counted=(one,)))
            say("CAD and one counted scan", replace(cad, counted=(one,)))
            say("three counted scans", replace(bare, counted=three))
            say("CAD and three counted scans", replace(cad, counted=three))
    return out


@dataclass(frozen=True)
class _PartWithModels(Part):
    """A part whose models are at hand, not in a file."""

    said: PartModels | None = None

    @property
    def models(self) -> PartModels | None:  # type: ignore[override]
        """Those."""
        return self.said


def format_table(rigs: list[Rig], answers: list[PartCount], refused: int) -> str:
    """Errors by what is known, then by container, and the worst parts."""
    lines = [f"{len(rigs)} rigs, {len({(r.family, r.seed) for r in rigs})} parts of "
             f"{len({r.family for r in rigs})} families, "
             f"{sum(len(r.scenes) for r in rigs)} scans, {refused} refused",
             f"{'':36}{'counts':>7}{'NAE':>7}{'median':>8}{'bias':>8}{'coverage':>10}"
             f"{'half width':>11}{'network':>9}"]
    lines += [_line(row, answers, row) for row in ROWS]
    for kind in sorted({r.kind for r in rigs}):
        of = {r.number for r in rigs if r.kind == kind}
        lines += [_line(f"{kind}: {row}", [a for a in answers if a.rig in of], row)
                  for row in ROWS[1:4]]
    for rig in rigs:
        of_rig = [a for a in answers if a.rig == rig.number]
        lines.append(f"{rig.family} {rig.seed}, {rig.kind}, friction {rig.friction:.2f}: NAE "
                     + ", ".join(f"{row} {_nae(of_rig, row):.3f}" for row in ROWS[:4]))
    return "\n".join(lines)


def _of(answers: list[PartCount], row: str, of: Callable[[PartCount], float]) -> np.ndarray:
    return np.array([of(a) for a in answers if a.row == row], float)


def _nae(answers: list[PartCount], row: str) -> float:
    return metrics.nae(_of(answers, row, lambda a: a.true), _of(answers, row, lambda a: a.count))


def _line(title: str, answers: list[PartCount], row: str) -> str:
    true, guess = _of(answers, row, lambda a: a.true), _of(answers, row, lambda a: a.count)
    hits = _of(answers, row, lambda a: a.low <= a.true <= a.high)
    half = _of(answers, row, lambda a: (a.high - a.low) / 2 / max(a.count, 1))
    share = _of(answers, row, lambda a: a.estimator_share)
    return (f"{title:36}{len(true):7}{metrics.nae(true, guess):7.3f}"
            f"{np.median(np.abs(guess / true - 1)):8.3f}{np.mean(guess / true - 1):+8.3f}"
            f"{hits.mean():10.2f}{np.median(half):11.3f}{np.median(share):9.2f}")


def format_sensitivity(models: list[PartModels]) -> str:
    """How gamma depends on what `part add` assumes: four part lengths high, six wide."""
    friction = [m.arc.per_tenth_of_friction for m in models]
    width = [m.arc.per_tenth_of_width(4, 6) for m in models]
    return (f"gamma per 0.1 of friction: {np.mean(friction):+.1%} (of the parts "
            f"{min(friction):+.1%} to {max(friction):+.1%}); per 10% error of the "
            f"container's width {np.mean(width):+.1%} ({min(width):+.1%} to {max(width):+.1%})")
