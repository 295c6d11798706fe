# SPDX-License-Identifier: Apache-2.0
"""One simulated scene, and what every estimator made of it."""

from __future__ import annotations

from dataclasses import dataclass

from stack_counter.types import Reason


@dataclass(frozen=True)
class Guess:
    """What one estimator makes of a scene.

    Attributes:
        gamma, count: the estimates.
        low, high: interval of the count.
        seconds: time that the estimate took.
        reasons: why it may be wrong, of V and of the estimate.
        status: of the count.
    """

    gamma: float
    count: int
    low: int
    high: int
    seconds: float
    reasons: tuple[Reason, ...]
    status: str


@dataclass(frozen=True)
class Case:
    """One scene: its truth and the guesses.

    Attributes:
        index: number of the scene in its set.
        family, complexity: family and surface complexity C of the part.
        kind: kind of the simulated container.
        count, gamma, fill: the truth.
        volume_error: relative error of V; NaN if the scan was refused.
        guesses: by estimator, a key of `cases.ROWS`; none if the scan was refused.
    """

    index: int
    family: str
    kind: str
    count: int
    gamma: float
    fill: float
    complexity: float
    volume_error: float
    guesses: dict[str, Guess]
