# SPDX-License-Identifier: Apache-2.0
"""What a scale under the container adds to vision, on simulated scans with drawn weights.

stack-counter evaluate weight --set train-deep --scenes 50
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.config import CounterConfig
from stack_counter.errors import StackCounterError
from stack_counter.eval.common import metrics
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import read_filled_scenes
from stack_counter.occupancy import make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.sim import Scene, reconstruct
from stack_counter.stack_count import count_stack
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import Reason, StackCount
from stack_counter.weighing.joined_count import SETTINGS as WEIGHING
from stack_counter.weighing.joined_count import PieceWeight, Weighing, use_weight


@dataclass(frozen=True)
class WeightDrawSettings:
    """How weights are drawn; chosen.

    Attributes:
        density: of the parts, kg/m3: steel.
        other_density: of the same parts in a wrong bin, kg/m3: aluminium.
        pieces: that were weighed for the mean.
        draws: weighings of each scan.
        seed: of the draws; recordings have seed 0.
        confidence: of the intervals.
        factors: between the weights of a wrong and the right bin, by which they are grouped.
    """

    density: float = 7850.0
    other_density: float = 2700.0
    pieces: int = 10
    draws: int = 20
    seed: int = 0
    confidence: float = 0.9
    factors: tuple[float, ...] = (1.0, 1.5, 2.0, 3.0)


SETTINGS = WeightDrawSettings()
SOURCES = ("vision", "weight", "joined")


@dataclass(frozen=True)
class WeighedScan:
    """One weighing of one scan.

    Attributes:
        index, draw: of the scene and of the weighing.
        true: number of parts.
        counts: by source, of `SOURCES`.
        intervals: low and high by source.
        flagged: whether the right bin was called a wrong one.
        material_flagged: the same of a bin with the same parts in another material.
        bin_flagged: the same where the scale has the bin of another scan on it, drawn at random.
        bin_factor: how many times as heavy or light that bin is, 1 or more.
    """

    index: int
    draw: int
    true: int
    counts: dict[str, int]
    intervals: dict[str, tuple[int, int]]
    flagged: bool
    material_flagged: bool
    bin_flagged: bool
    bin_factor: float


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    scenes = read_filled_scenes(options.set, options.scenes)
    visions = list(progress(map_tasks(count_by_vision, scenes, Workers.of(options)), "scans",
                            "scans", len(scenes)))
    counted = [(scene, vision) for scene, vision in zip(scenes, visions) if vision is not None]
    scans = draw_weighings(counted, options.scale_std_g * 1e-3, options.scatter)
    print(f"{options.set}: {len(counted)} scans of {len(scenes)}, steel, pieces differ by "
          f"{options.scatter:.1%}, mean of {SETTINGS.pieces}, scale and tare "
          f"{options.scale_std_g:g} g; {SETTINGS.draws} draws of the weights")
    print(format_table(scans))
    if options.json:
        write_figures(options.json, scans)
    return 0


def count_by_vision(scene: Scene) -> StackCount | None:
    """Counts a recorded scene, v known alone; None where the scan is refused."""
    try:
        volume = replace(reconstruct(scene), mesh=None)  # large, and on its way between processes
        return count_stack(volume, Part(scene.truth.unit_volume), make_estimator(CounterConfig()),
                           SETTINGS.confidence)
    except StackCounterError as error:
        print(f"scene {scene.index}: {error}")
        return None


def draw_weighings(counted: Sequence[tuple[Scene, StackCount]], scale_std_kg: float,
                   scatter: float) -> list[WeighedScan]:
    """Draws weights of scans, and joins them with their counts.

    Args:
        counted: scenes and their counts by vision.
        scale_std_kg: standard deviation of a net weight, kg.
        scatter: standard deviation from piece to piece, relative.
    """
    scans = []
    masses = [scene.truth.unit_volume * scene.truth.count for scene, _ in counted]
    for number, (scene, vision) in enumerate(counted):
        for draw in range(SETTINGS.draws):
            random = np.random.default_rng((SETTINGS.seed, scene.index, draw))
            lot = SETTINGS.density * scene.truth.unit_volume * (
                1 + WEIGHING.lot_std_share * random.normal())
            weighed = random.normal(lot, scatter * lot, SETTINGS.pieces)
            piece = PieceWeight(float(weighed.mean()), scatter * lot, SETTINGS.pieces)
            net = random.normal(lot, scatter * lot, scene.truth.count).sum()
            error = scale_std_kg * random.normal()
            other = (number + random.integers(1, len(counted))) % len(counted)
            right, material, wrong_bin = (
                use_weight(vision, Weighing(float(kg + error), scale_std_kg), piece) for kg in (
                    net, net * SETTINGS.other_density / SETTINGS.density,
                    SETTINGS.density * masses[other]))
            ratio = masses[other] / masses[number]
            scans.append(_weighed_scan(scene, draw, max(ratio, 1 / ratio), right, material,
                                       wrong_bin))
    return scans


def _weighed_scan(scene: Scene, draw: int, bin_factor: float, right: StackCount,
                  *wrong: StackCount) -> WeighedScan:
    vision, weight = right.sources
    flags = (Reason.FOREIGN_PARTS_OR_WRONG_BIN in count.reasons for count in (right, *wrong))
    said = dict(zip(SOURCES, (vision, weight, right)))
    return WeighedScan(scene.index, draw, scene.truth.count,
                       {name: count.count for name, count in said.items()},
                       {name: count.count_interval for name, count in said.items()}, *flags,
                       bin_factor)


def format_table(scans: list[WeighedScan]) -> str:
    """Errors of each source in the first weighing of each scan and in all; what is flagged."""
    first = [scan for scan in scans if scan.draw == 0]
    lines = [f"{'':24}{'n':>6}{'NAE':>9}{'bias':>9}{'coverage':>10}{'half width':>12}"]
    for title, group in (("", first), (", all draws", scans)):
        lines += [_format_line(f"{source}{title}", group, source) for source in SOURCES]
    flags = {"right bins": [scan.flagged for scan in scans],
             "parts of another material": [scan.material_flagged for scan in scans]}
    for low, high in zip(SETTINGS.factors, (*SETTINGS.factors[1:], np.inf)):
        flags[f"another bin, {low:g} to {high:g} times as heavy or light"] = [
            scan.bin_flagged for scan in scans if low <= scan.bin_factor < high]
    return "\n".join([*lines, *(f"{title}: {sum(flagged)} of {len(flagged)} flagged"
                                for title, flagged in flags.items())])


def _format_line(title: str, scans: list[WeighedScan], source: str) -> str:
    true = np.array([scan.true for scan in scans], float)
    guess = np.array([scan.counts[source] for scan in scans], float)
    low, high = np.array([scan.intervals[source] for scan in scans]).T
    return (f"{title:24}{len(scans):6}{metrics.nae(true, guess):9.4f}"
            f"{np.mean(guess / true - 1):+9.4f}{np.mean((low <= true) & (true <= high)):10.2f}"
            f"{np.median((high - low) / 2 / np.maximum(guess, 1)):12.4f}")
