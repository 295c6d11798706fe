# SPDX-License-Identifier: Apache-2.0
"""Images of several cameras that were triggered together become one scan."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

from stack_counter.errors import ViewError
from stack_counter.types import View
from stack_counter.views.awake_clock import awake_time


@dataclass(eq=False)
class Cycle:
    """The views of one trigger.

    Attributes:
        stamp_ns: stamp of its first view, ns.
        views: its views by camera.
        open_since: time of `awake_time` at which it began, seconds.
    """

    stamp_ns: int
    views: dict[str, View] = field(default_factory=dict)
    open_since: float = field(default_factory=awake_time)


def cycle_scan_id(stamp_ns: int) -> str:
    """Returns the id of the scan that a cycle is; `stamp_ns`: of its first view."""
    return f"cycle_{stamp_ns}"


def cycle_stamp_ns(scan_id: str) -> int:
    """Returns the stamp of a cycle's first view, ns, of the id of the scan that it is."""
    return int(scan_id.removeprefix("cycle_"))


class CycleGrouper:
    """Groups views into cycles and closes those that are over.

    A cycle is over when every camera has given its view, when a later cycle is, or when the
    timeout has passed: live, while this process ran; in a recording, in the images' own time.

    Attributes:
        cameras: names of the rig's cameras.
    """

    def __init__(self, cameras: Iterable[str], tolerance_s: float, timeout_s: float, live: bool):
        """Makes a grouper without views.

        Args:
            cameras: names of the rig's cameras.
            tolerance_s: largest difference of stamps within one cycle, seconds.
            timeout_s: time after which a cycle is over though cameras are missing, seconds.
            live: the timeout is one of the time that this process runs.
        """
        self.cameras = tuple(cameras)
        self._live = live
        self._tolerance_ns, self._timeout_ns = round(tolerance_s * 1e9), round(timeout_s * 1e9)
        self._open: list[Cycle] = []  # by stamp
        self._closed_ns: int | None = None  # stamp of the last cycle closed

    def missing_cameras(self, cycle: Cycle) -> list[str]:
        """Returns the names of the cameras that gave a cycle no view."""
        return [name for name in self.cameras if name not in cycle.views]

    def add_view(self, camera: str, view: View) -> list[Cycle]:
        """Takes a view into its cycle.

        Returns:
            The cycles that are over now, oldest first.

        Raises:
            ViewError: reason `late`: the view's cycle is over already.
        """
        stamp = view.stamp_ns
        over = [] if self._live else self._close_where(
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
        if not self.missing_cameras(mine):
            over += self._close_where(lambda c: c.stamp_ns <= mine.stamp_ns)
        return over

    def close_expired(self) -> list[Cycle]:
        """Closes and returns the cycles whose time is up, live."""
        now = awake_time()
        return self._close_where(lambda c: now - c.open_since > self._timeout_ns * 1e-9)

    def close_all(self) -> list[Cycle]:
        """Closes and returns all cycles, since no more views will come."""
        return self._close_where(lambda c: True)

    def _close_where(self, is_over: Callable[[Cycle], bool]) -> list[Cycle]:
        over = [c for c in self._open if is_over(c)]
        if over:
            self._closed_ns = over[-1].stamp_ns
            self._open = [c for c in self._open if c.stamp_ns > self._closed_ns]
        return over
