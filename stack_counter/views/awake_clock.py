# SPDX-License-Identifier: Apache-2.0
"""Time that passes only while this process runs: what waits in its own queues is not late."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass


@dataclass(frozen=True)
class AwakeClockSettings:
    """When the process counts as having stood still.

    Attributes:
        max_step_s: of a longer time between two calls, seconds, only this much counts. Chosen as
            twice the period of the collector's timer, which calls.
    """

    max_step_s: float = 0.2


SETTINGS = AwakeClockSettings()


class AwakeClock:
    """Monotonic clock, seconds, that stands still while nobody asks it, as a busy node does."""

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        """Makes one that runs with a monotonic clock, seconds."""
        self._clock, self._asked_at = clock, clock()
        self._time = 0.0

    def __call__(self) -> float:
        """Returns the time, seconds."""
        now = self._clock()
        self._time += min(now - self._asked_at, SETTINGS.max_step_s)
        self._asked_at = now
        return self._time


awake_time = AwakeClock()  # of this process
