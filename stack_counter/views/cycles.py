"""Images of several cameras that were triggered together become one scan."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from stack_counter.errors import ViewError
from stack_counter.types import View


@dataclass
class Cycle:
    """One trigger: its first stamp in ns, the views by camera, and since when it is open (s,
    monotonic)."""

    stamp_ns: int
    views: dict[str, View] = field(default_factory=dict)
    since: float = field(default_factory=time.monotonic)


class CycleGrouper:
    """Sorts views into cycles; says when one is over.

    A cycle is over when every camera has given its view, when a later cycle is, or when the
    timeout has passed: live, on the wall's clock; in a recording, in the images' own time.
    """

    def __init__(self, cameras: Iterable[str], tolerance_s: float, timeout_s: float, live: bool):
        self.cameras = tuple(cameras)
        self._live = live
        self._tolerance_ns, self._timeout_ns = round(tolerance_s * 1e9), round(timeout_s * 1e9)
        self._open: list[Cycle] = []  # by stamp
        self._closed_ns: int | None = None  # stamp of the last one that is over

    def missing(self, cycle: Cycle) -> list[str]:
        """Cameras that gave it no view."""
        return [name for name in self.cameras if name not in cycle.views]

    def add(self, camera: str, view: View) -> list[Cycle]:
        """Takes a view; returns the cycles that are over now, oldest first.

        Raises:
            ViewError: reason `late`: its cycle is over already.
        """
        stamp = view.stamp_ns
        over = [] if self._live else self._take(
            lambda c: stamp - c.stamp_ns > self._timeout_ns)
        if self._closed_ns is not None and stamp < self._closed_ns - 10 * self._timeout_ns:
            self._closed_ns = None  # the clock was set back
        if self._closed_ns is not None and stamp <= self._closed_ns + self._tolerance_ns:
            raise ViewError("late", f"'{camera}' at {stamp} ns; expected it with the others, at "
                                    f"{self._closed_ns} ns")
        mine = next((c for c in self._open if abs(c.stamp_ns - stamp) <= self._tolerance_ns
                     and camera not in c.views), None)
        if mine is None:
            mine = Cycle(stamp)
            self._open = sorted([*self._open, mine], key=lambda c: c.stamp_ns)
        mine.views[camera] = view
        if not self.missing(mine):
            over += self._take(lambda c: c.stamp_ns <= mine.stamp_ns)
        return over

    def expired(self) -> list[Cycle]:
        """Cycles whose time is up on the wall's clock."""
        now = time.monotonic()
        return self._take(lambda c: now - c.since > self._timeout_ns * 1e-9)

    def flush(self) -> list[Cycle]:
        """All that are open: nothing more will come."""
        return self._take(lambda c: True)

    def _take(self, is_over: Callable[[Cycle], bool]) -> list[Cycle]:
        over = [c for c in self._open if is_over(c)]
        if over:
            self._closed_ns = over[-1].stamp_ns
            self._open = [c for c in self._open if c.stamp_ns > self._closed_ns]
        return over
