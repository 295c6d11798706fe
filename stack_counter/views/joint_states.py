# SPDX-License-Identifier: Apache-2.0
"""Joint positions of a robot at a stamp, interpolated between recorded or live joint states."""

from __future__ import annotations

import bisect
import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.views import decoding


@dataclass(frozen=True)
class JointStatesSettings:
    """How samples are kept and compared; chosen.

    Attributes:
        kept_ns: samples older than the newest by more than this are forgotten.
        clock_jump_ns: a sample that is older than the newest by more than this is no late one: the
            clock was set back.
        at_rest: joints that differ by no more across a gap, rad or m, have not moved in it.
    """

    kept_ns: int = 60 * 10**9
    clock_jump_ns: int = 10**9
    at_rest: float = 1e-3


SETTINGS = JointStatesSettings()


@dataclass(eq=False)
class _Series:
    """Samples of the joints that one publisher names, in stamp order."""

    stamps: list[int] = field(default_factory=list)
    positions: list[np.ndarray] = field(default_factory=list)

    def add(self, stamp_ns: int, positions: np.ndarray) -> None:
        if self.stamps and self.stamps[-1] - stamp_ns > SETTINGS.clock_jump_ns:
            self.stamps, self.positions = [], []
        i = bisect.bisect_left(self.stamps, stamp_ns)
        self.stamps.insert(i, stamp_ns)
        self.positions.insert(i, positions)
        old = bisect.bisect_left(self.stamps, self.stamps[-1] - SETTINGS.kept_ns)
        if old:
            del self.stamps[:old], self.positions[:old]

    def position_at(self, stamp_ns: int, max_gap_ns: int) -> np.ndarray | str:
        """The (n,) positions at a stamp, or the gap around it in words."""
        i = bisect.bisect_left(self.stamps, stamp_ns)
        if i < len(self.stamps) and self.stamps[i] == stamp_ns:
            return self.positions[i]
        before = stamp_ns - self.stamps[i - 1] if i else None
        after = self.stamps[i] - stamp_ns if i < len(self.stamps) else None
        if before is not None and after is not None:
            step = self.positions[i] - self.positions[i - 1]
            # A joint that turns without end may be counted from -pi again.
            step = np.where(np.abs(step) > math.pi, np.remainder(step + math.pi, math.tau)
                            - math.pi, step)
            if before + after <= max_gap_ns or np.abs(step).max() <= SETTINGS.at_rest:
                return self.positions[i - 1] + step * (before / (before + after))
        sides = [f"{x / 1e6:.1f} ms" if x is not None else "nothing" for x in (before, after)]
        return f"{sides[0]} before and {sides[1]} after the image"


class JointStates:
    """Positions of the joints that a robot's model needs."""

    def __init__(self, names: Iterable[str], topic: str, max_gap_s: float):
        """Makes one without samples.

        Args:
            names: of the joints.
            topic: names the messages in errors.
            max_gap_s: widest gap between two samples that is interpolated in, seconds.
        """
        self._names, self._topic = set(names), topic
        self._max_gap_ns = round(max_gap_s * 1e9)
        self._series: dict[tuple[str, ...], _Series] = {}

    def add_message(self, message: Any) -> None:
        """Takes a `JointState`; joints of others, and positions that are no numbers, are left."""
        found = {name: float(x) for name, x in zip(message.name, message.position)
                 if name in self._names and math.isfinite(x)}
        if found:
            series = self._series.setdefault(tuple(found), _Series())
            series.add(decoding.stamp_ns(message.header.stamp), np.array(list(found.values())))

    def is_ready(self, stamp_ns: int) -> bool:
        """Tells whether later samples cannot change what `positions_at` returns."""
        return self._names <= {name for names, series in self._series.items()
                               if series.stamps[-1] >= stamp_ns for name in names}

    def positions_at(self, stamp_ns: int) -> dict[str, float]:
        """Returns the position, rad or m, of every joint by its name.

        Raises:
            ViewError: reason `no_joint_state`.
        """
        found: dict[str, float] = {}
        gaps: dict[str, str] = {}
        for names, series in self._series.items():
            positions = series.position_at(stamp_ns, self._max_gap_ns)
            if isinstance(positions, str):
                gaps |= dict.fromkeys(names, f"has {positions}")
            else:
                found |= dict(zip(names, positions.tolist()))
        missing = sorted(self._names - set(found))
        if missing:
            raise ViewError("no_joint_state",
                            f"joint '{missing[0]}' {gaps.get(missing[0], 'never came')} on "
                            f"{self._topic}; expected samples of {len(self._names)} joints at "
                            f"most {self._max_gap_ns / 1e6:.0f} ms apart")
        return found
