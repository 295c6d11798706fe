# SPDX-License-Identifier: Apache-2.0
"""A part of a recording, as `--start` and `--end` name it."""

from __future__ import annotations

import math
from dataclasses import dataclass

from stack_counter.errors import ConfigError


@dataclass(frozen=True)
class TimeRange:
    """From one time to before another, after the first message of a bag, by its recorder's clock.

    Attributes:
        start_ns: ns after the beginning of the bag.
        end_ns: ns after the beginning of the bag; None: to its end.
    """

    start_ns: int = 0
    end_ns: int | None = None

    @classmethod
    def of_seconds(cls, start: float | None, end: float | None) -> TimeRange:
        """A range given in seconds; None: from the beginning, or to the end.

        Raises:
            ConfigError: it is empty, or begins before the bag.
        """
        begin, stop = start or 0.0, math.inf if end is None else end
        if not 0 <= begin < stop:
            raise ConfigError(f"--start is {begin:g}, --end {'not given' if end is None else end}"
                              "; expected 0 <= start < end, seconds after the bag's first message")
        return cls(round(begin * 1e9), None if math.isinf(stop) else round(stop * 1e9))

    def between(self, bag_start_ns: int) -> tuple[int, int]:
        """Log times, ns since 1970, from which on and before which, in a bag of this start."""
        end_ns = 2**62 if self.end_ns is None else self.end_ns
        return bag_start_ns + self.start_ns, min(bag_start_ns + end_ns, 2**62)


WHOLE_BAG = TimeRange()
