# SPDX-License-Identifier: Apache-2.0
"""Counts of known parts, and their tables."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from stack_counter.eval.common import metrics
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import Scene
from stack_counter.types import Reason

# Rows of the table: what is known of the part.
ROWS = ("v only", "v and size", "mesh", "CAD", "one counted scan", "CAD and one counted scan",
        "three counted scans", "CAD and three counted scans")
# Fill, in part lengths, at which the sensitivity of gamma is stated.
_HEIGHT, _WIDTH = 4, 6


@dataclass(frozen=True)
class PartCount:
    """One count of one scan.

    Attributes:
        row: what is known of the part, one of `ROWS`.
        rig, scan: numbers of the rig and of the scene.
        true, count: true and estimated count.
        low, high: interval of the count.
        estimator_share: share of gamma that comes from the network.
        reasons: why the count may be wrong.
    """

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
    """One part in one container with one friction, and its scenes.

    Attributes:
        number: number of the rig in its set.
        family, seed: which part.
        kind: kind of the simulated container.
        friction: coefficient of all contacts.
        scenes: its piles.
    """

    number: int
    family: str
    seed: int
    kind: str
    friction: float
    scenes: list[Scene]


def format_table(rigs: list[Rig], counts: list[PartCount], refused: int) -> str:
    """Errors by what is known, then by container, and by rig."""
    lines = [f"{len(rigs)} rigs, {len({(r.family, r.seed) for r in rigs})} parts of "
             f"{len({r.family for r in rigs})} families, "
             f"{sum(len(r.scenes) for r in rigs)} scans, {refused} refused",
             f"{'':36}{'counts':>7}{'NAE':>7}{'median':>8}{'bias':>8}{'coverage':>10}"
             f"{'half width':>11}{'network':>9}"]
    lines += [_format_line(row, counts, row) for row in ROWS]
    for kind in sorted({r.kind for r in rigs}):
        numbers = {r.number for r in rigs if r.kind == kind}
        of_kind = [c for c in counts if c.rig in numbers]
        lines += [_format_line(f"{kind}: {row}", of_kind, row) for row in ROWS[1:4]]
    for rig in rigs:
        of_rig = [c for c in counts if c.rig == rig.number]
        lines.append(f"{rig.family} {rig.seed}, {rig.kind}, friction {rig.friction:.2f}: NAE "
                     + ", ".join(f"{row} {_nae(of_rig, row):.3f}" for row in ROWS[:4]))
    return "\n".join(lines)


def _values(counts: list[PartCount], row: str, value: Callable[[PartCount], float]
            ) -> np.ndarray:
    return np.array([value(c) for c in counts if c.row == row], float)


def _nae(counts: list[PartCount], row: str) -> float:
    return metrics.nae(_values(counts, row, lambda c: c.true),
                       _values(counts, row, lambda c: c.count))


def _format_line(title: str, counts: list[PartCount], row: str) -> str:
    true = _values(counts, row, lambda c: c.true)
    guess = _values(counts, row, lambda c: c.count)
    hits = _values(counts, row, lambda c: c.low <= c.true <= c.high)
    half_width = _values(counts, row, lambda c: (c.high - c.low) / 2 / max(c.count, 1))
    share = _values(counts, row, lambda c: c.estimator_share)
    return (f"{title:36}{len(true):7}{metrics.nae(true, guess):7.3f}"
            f"{np.median(np.abs(guess / true - 1)):8.3f}{np.mean(guess / true - 1):+8.3f}"
            f"{hits.mean():10.2f}{np.median(half_width):11.3f}{np.median(share):9.2f}")


def format_sensitivity(models: list[PartModels]) -> str:
    """How gamma depends on what `part add` assumes: four part lengths high, six wide."""
    friction = [m.arc.per_tenth_of_friction for m in models]
    width = [m.arc.per_tenth_of_width(_HEIGHT, _WIDTH) for m in models]
    return (f"gamma per 0.1 of friction: {np.mean(friction):+.1%} (of the parts "
            f"{min(friction):+.1%} to {max(friction):+.1%}); per 10% error of the "
            f"container's width {np.mean(width):+.1%} ({min(width):+.1%} to {max(width):+.1%})")
