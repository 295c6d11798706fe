# SPDX-License-Identifier: Apache-2.0
"""Which of a scale's readings belongs to a scan: the newest stable one."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from itertools import islice

import numpy as np


@dataclass(frozen=True)
class ScaleReadingsSettings:
    """When a weight is stable; chosen.

    Attributes:
        settle_s: how long readings must agree, s. A reading holds until the next one, so a
            scale that speaks only when the weight has changed is stable too.
        agreement: how far readings may lie apart to agree, in standard deviations of a weighing.
    """

    settle_s: float = 1.0
    agreement: float = 3.0


SETTINGS = ScaleReadingsSettings()


class ScaleReadings:
    """The readings of a scale, oldest first."""

    def __init__(self, std_kg: float, max_age_s: float):
        """Begins without a reading.

        Args:
            std_kg: standard deviation of a weighing, kg.
            max_age_s: how old a stable reading may be to belong to a scan, s.
        """
        self._tolerance = SETTINGS.agreement * std_kg
        self._max_age_ns = round(max_age_s * 1e9)
        self._readings: deque[tuple[int, float]] = deque()

    def add(self, time_ns: int, weight_kg: float) -> None:
        """Takes a reading, later than those before; one that is no number agrees with none."""
        self._readings.append((time_ns, weight_kg))

    def forget_before(self, time_ns: int) -> None:
        """Forgets what can belong to no scan after this time."""
        oldest = time_ns - self._max_age_ns - 2 * round(SETTINGS.settle_s * 1e9)
        while self._readings and self._readings[0][0] < oldest:
            self._readings.popleft()

    def stable_weight(self, time_ns: int) -> float | None:
        """Returns the newest stable weight at a time, kg; None where there is none new enough."""
        end_ns = time_ns
        for newest, (reading_ns, weight) in enumerate(reversed(self._readings)):
            if reading_ns > time_ns:
                continue
            if time_ns - reading_ns > self._max_age_ns:
                return None
            agreeing = self._agreeing(newest)
            if agreeing and end_ns - agreeing[-1][0] >= SETTINGS.settle_s * 1e9:
                last = [kg for at_ns, kg in agreeing if at_ns >= end_ns - SETTINGS.settle_s * 1e9]
                return float(np.median(last or [weight]))
            end_ns = reading_ns
        return None

    def _agreeing(self, newest: int) -> list[tuple[int, float]]:
        """Returns the readings in a row, newest first, that agree with one, and it.

        Args:
            newest: number of the reading, counted from the last one.
        """
        backwards = islice(reversed(self._readings), newest, None)
        agreeing: list[tuple[int, float]] = []
        for time_ns, weight in backwards:
            if not abs(weight - (agreeing[0][1] if agreeing else weight)) <= self._tolerance:
                break
            agreeing.append((time_ns, weight))
        return agreeing
