# SPDX-License-Identifier: Apache-2.0
"""The count by the weight on a scale, joined with the one by vision by their variances.

A scale knows nothing of what lies on it, and vision knows that and counts less exactly: where both
agree the joined count rests on each by its variance, where they do not something is wrong.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from stack_counter.config import CounterConfig
from stack_counter.counting import whole_interval, with_reasons
from stack_counter.types import Reason, SourceCount, StackCount


@dataclass(frozen=True)
class WeighingSettings:
    """How far vision and the scale are believed; all chosen.

    Attributes:
        max_z: standard deviations by which the two may differ; beyond, the scale is not believed.
        vision_share: probability of the interval that says vision's standard deviation, each side
            for itself: its errors are shares, and their tails are heavier than a normal one's.
        least_vision_std: standard deviation of a count by vision, parts, however sure it is: what
            lies flat on the floor may not show.
        none: number of parts, on the logarithmic scale, that stands for none.
        piece_std_share: scatter of pieces, relative to their mean, where it is not given.
        lot_std_share: standard deviation of the mean of a lot's pieces, relative, beside the
            error of its own weighing: counting scales err by 0.1 to 0.5%.
    """

    max_z: float = 3.0
    vision_share: float = 0.9
    least_vision_std: float = 1.0
    none: float = 0.4
    piece_std_share: float = 0.01
    lot_std_share: float = 0.002


SETTINGS = WeighingSettings()
REFERENCE_PIECES = 10  # pieces that counting scales take for a mean, where nobody says how many


@dataclass(frozen=True)
class PieceWeight:
    """What a piece weighs.

    Attributes:
        mean_kg: mean of the pieces that were weighed, kg.
        std_kg: standard deviation from piece to piece, kg.
        pieces: number of pieces that were weighed.
    """

    mean_kg: float
    std_kg: float
    pieces: int = REFERENCE_PIECES

    @property
    def mean_std_kg(self) -> float:
        """Standard deviation of the mean: the same error in every piece of a container, kg."""
        return math.hypot(self.std_kg / math.sqrt(self.pieces),
                          SETTINGS.lot_std_share * self.mean_kg)


@dataclass(frozen=True)
class Weighing:
    """What a scale says of one scan.

    Attributes:
        net_kg: weight of the parts, kg; None where the scale gave no stable weight in time.
        std_kg: its standard deviation, the tare's with it, kg.
    """

    net_kg: float | None
    std_kg: float


def weighing_of(config: CounterConfig, gross_kg: float | None) -> Weighing | None:
    """What the scale of the settings says; None where they name none.

    Args:
        config: settings; a weight that they give as a number holds before any reading.
        gross_kg: stable weight with the container's, kg; None where there is none.
    """
    if math.isfinite(config.weight_kg):
        gross_kg = config.weight_kg
    elif not config.weight_topic:
        return None
    return Weighing(None if gross_kg is None else gross_kg - config.tare_kg, config.weight_std_kg)


@dataclass(frozen=True)
class WeighedCount:
    """A count by weight.

    Attributes:
        expected: number of pieces of that weight; may lie between numbers, or below 0.
        std: its standard deviation, pieces.
    """

    expected: float
    std: float


def count_by_weight(net_kg: float, std_kg: float, piece: PieceWeight) -> WeighedCount:
    """Counts by weight.

    Of n pieces the scatter adds up to sqrt(n) times that of one, an error of their mean to n
    times it, and the scale's own error does not depend on n.

    Args:
        net_kg: weight of the parts, kg.
        std_kg: its standard deviation, kg.
        piece: what one of them weighs.
    """
    expected = net_kg / piece.mean_kg
    n = max(expected, 0.0)
    error_kg = math.hypot(math.sqrt(n) * piece.std_kg, n * piece.mean_std_kg, std_kg)
    return WeighedCount(expected, error_kg / piece.mean_kg)


def use_weight(count: StackCount, weighing: Weighing | None, piece: PieceWeight | None
               ) -> StackCount:
    """Joins a count by vision with what a scale says, or says why it does not.

    Args:
        count: by vision.
        weighing: None where there is no scale.
        piece: weight of a piece; None where it is not known.
    """
    if weighing is None:
        return count
    if weighing.net_kg is None:
        return with_reasons(count, Reason.NO_WEIGHT)
    if piece is None or count.volume.region:
        return with_reasons(count, Reason.WEIGHT_UNUSED)
    return join_weight(count, weighing.net_kg, count_by_weight(weighing.net_kg, weighing.std_kg,
                                                               piece))


def join_weight(count: StackCount, net_kg: float, weighed: WeighedCount) -> StackCount:
    """Joins a count by vision with one by weight, or says that they disagree.

    Both are compared and joined as logarithms, since vision's errors are shares; of its interval,
    which is not symmetric, the side towards the other count tells.

    Args:
        count: by vision, with its distribution.
        net_kg: weight of the parts, kg.
        weighed: the count by it.

    Returns:
        The joined count; where the two differ by more than `max_z` standard deviations the count
        by vision, with the reason `foreign_parts_or_wrong_bin` and an interval over both.
    """
    z_of_end = NormalDist().inv_cdf((1 + count.confidence) / 2)
    end = z_of_end * weighed.std
    by_weight = max(round(weighed.expected), 0)
    weight_interval = whole_interval(max(weighed.expected - end, 0.0), by_weight,
                                     weighed.expected + end)
    # Compare the two.
    vision = _VisionLog.of(count)
    weight_log = _log(weighed.expected)
    vision_std = vision.std_towards(weight_log)
    weight_std = weighed.std / max(weighed.expected, 1.0)
    difference = weight_log - vision.middle
    difference_std = math.hypot(vision_std, weight_std)
    agree = abs(difference) <= SETTINGS.max_z * difference_std
    share = (vision_std / difference_std) ** 2 if agree else 0.0
    sources = (replace(count.sources[0], share=1 - share),
               SourceCount("weight", by_weight, weight_interval, share))
    said = replace(count, sources=sources, net_weight_kg=net_kg)
    if not agree:  # nobody knows which of them is right
        both = tuple(zip(count.count_interval, weight_interval))
        return with_reasons(replace(said, count_interval=(min(both[0]), max(both[1]))),
                            Reason.FOREIGN_PARTS_OR_WRONG_BIN)
    # Join them by their variances.
    middle, std = vision.middle + share * difference, vision_std * weight_std / difference_std
    expected = math.exp(middle)
    joined = round(expected)
    low, high = (expected * math.exp(sign * z_of_end * std) for sign in (-1, 1))
    return replace(said, count=joined, count_interval=whole_interval(low, joined, high),
                   distribution=_distribution(middle, std, count.distribution))


@dataclass(frozen=True)
class _VisionLog:
    """A count by vision as a logarithm, with a standard deviation on each side."""

    middle: float
    std_below: float
    std_above: float

    @classmethod
    def of(cls, count: StackCount) -> _VisionLog:
        """The logarithm of a count by vision."""
        expected = count.gamma * count.volume.stack_volume / count.unit_volume
        middle, below, above = _log(expected), 0.0, 0.0
        if count.distribution is not None:
            tail = (1 - SETTINGS.vision_share) / 2
            low, high = np.quantile(count.distribution, [tail, 1 - tail])
            z = NormalDist().inv_cdf(1 - tail)
            below, above = (max(side, 0.0) / z for side in (
                math.log(expected / low), math.log(high / expected)))
        least = SETTINGS.least_vision_std / max(expected, 1.0)
        return cls(middle, math.hypot(below, least), math.hypot(above, least))

    def std_towards(self, other: float) -> float:
        """The standard deviation on the side of another logarithm."""
        return self.std_above if other > self.middle else self.std_below


def _log(number: float) -> float:
    """The logarithm of a number of parts, of which none has one too."""
    return math.log(max(number, SETTINGS.none))


def _distribution(middle: float, std: float, before: np.ndarray | None) -> np.ndarray | None:
    """Returns (n,) counts as likely as each other, rising, of a joined logarithm."""
    if before is None:
        return None
    normal = NormalDist(middle, std)
    return np.exp([normal.inv_cdf((i + 0.5) / len(before)) for i in range(len(before))])
