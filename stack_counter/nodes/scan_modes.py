# SPDX-License-Identifier: Apache-2.0
"""The collector's three modes: one scan on request, one that never ends, one for each cycle."""

from __future__ import annotations

import time
import uuid
from collections.abc import Callable

from stack_counter.errors import ScanError, ViewError
from stack_counter.nodes.scan_events import Problem, ScanEvent, ScanOpened, ViewDropped
from stack_counter.nodes.scan_queue import QueuedScan
from stack_counter.nodes.scan_session import ScanSession, ViewSource
from stack_counter.types import PartRequest, View
from stack_counter.views.cycles import Cycle, CycleGrouper, cycle_scan_id
from stack_counter.views.rig import Rig


def make_session(mode: str, rig: Rig, source: ViewSource,
                 requested_part: Callable[[], PartRequest]) -> ScanSession:
    """Makes an idle session.

    Args:
        mode: `scan`, `continuous` or `cycle`.
        rig: the cameras, and how far apart the images of one cycle may be.
        source: assembles their views.
        requested_part: gives the part that a new scan is of.
    """
    if mode == "cycle":
        cycles = CycleGrouper([camera.name for camera in rig.cameras], rig.tolerance_s,
                              rig.timeout_s, live=True)
        return CycleScans(source, requested_part, cycles)
    return (ContinuousScan if mode == "continuous" else SingleScan)(source, requested_part)


class SingleScan(ScanSession):
    """One scan from `start_scan` to `stop_scan`."""

    newest_only = False

    def check_startable(self) -> None:
        """Refuses to start while a scan is open.

        Raises:
            ScanError: one is open.
        """
        if self.accepting_images and self.scan is not None:
            raise ScanError(f"scan '{self.scan.scan_id}' is open; expected none: stop it first")

    def start(self, scan_id: str = "") -> list[ScanEvent]:
        """Opens a scan."""
        return self.open_scan(scan_id)

    def add_view(self, camera: str, view: View) -> list[ScanEvent]:
        """Takes a view into the open scan."""
        dropped = self.scan.add(camera, view) if self.scan is not None else None
        return [] if dropped is None else [ViewDropped(dropped)]

    def end_on_request(self, scan: QueuedScan) -> list[ScanEvent]:
        """Closes the scan."""
        self.accepting_images = False
        return self.close_scan(scan)

    def open_scan(self, scan_id: str) -> list[ScanEvent]:
        """Opens a scan of the requested part."""
        scan = QueuedScan(scan_id or uuid.uuid4().hex[:8], self.requested_part(),
                          newest_only=self.newest_only)
        return self.begin_scan(scan, recorded_as=scan)


class ContinuousScan(SingleScan):
    """A scan that never ends: to start or stop one ends it and begins the next."""

    needs_no_request = newest_only = True

    def check_startable(self) -> None:
        """Allows every start: the open scan ends for it."""

    def start(self, scan_id: str = "") -> list[ScanEvent]:
        """Closes the open scan, if there is one, and opens the next."""
        closing: list[ScanEvent] = []
        if self.accepting_images and self.scan is not None:
            closing = self.close_scan(self.scan)
        return closing + self.open_scan(scan_id)

    def end_on_request(self, scan: QueuedScan) -> list[ScanEvent]:
        """Closes the scan and opens the next."""
        return super().end_on_request(scan) + self.open_scan("")


class CycleScans(ScanSession):
    """Each set of images of a rig's cameras is a scan of its own."""

    needs_no_request = True

    def __init__(self, source: ViewSource, requested_part: Callable[[], PartRequest],
                 cycles: CycleGrouper, clock: Callable[[], float] = time.monotonic):
        """Makes an idle session.

        Args:
            source: assembles views.
            requested_part: gives the part of a new scan.
            cycles: groups the views of the rig's cameras.
            clock: monotonic time, seconds.
        """
        super().__init__(source, requested_part, clock)
        self._cycles = cycles

    @property
    def open_scan_id(self) -> str:
        """Empty: a cycle gets its id from its first image."""
        return ""

    def start(self, scan_id: str = "") -> list[ScanEvent]:
        """Takes images, if they are not taken already; the next cycle is the scan."""
        return [] if self.accepting_images else self.begin_scan(
            None, recorded_as=QueuedScan("cycle", self.requested_part()))

    def add_view(self, camera: str, view: View) -> list[ScanEvent]:
        """Takes a view into its cycle; cycles that are over become scans."""
        try:
            return self._close_cycles(self._cycles.add_view(camera, view))
        except ViewError as error:
            self.late[f"late_{camera}"] += 1
            return [Problem(str(error), repeated=True)]

    def close_waiting(self, expired_only: bool) -> list[ScanEvent]:
        """Makes scans of the cycles that wait for a camera."""
        return self._close_cycles(self._cycles.close_expired() if expired_only
                                  else self._cycles.close_all())

    def end_on_request(self, scan: QueuedScan) -> list[ScanEvent]:
        """Goes on: the cycle that was open has become a scan."""
        return []

    def _close_cycles(self, cycles: list[Cycle]) -> list[ScanEvent]:
        return [event for cycle in cycles for event in self._close_cycle(cycle)]

    def _close_cycle(self, cycle: Cycle) -> list[ScanEvent]:
        """Makes a cycle a scan of its own, with all its views there."""
        scan = QueuedScan(cycle_scan_id(cycle.stamp_ns), self.requested_part())
        for camera in self._cycles.cameras:
            if camera in cycle.views:
                scan.add(camera, cycle.views[camera])
        scan.missing = tuple(self._cycles.missing_cameras(cycle))
        given_up = self.queue.enqueue(scan)
        problems = [Problem(f"scan '{other.scan_id}' given up: {len(self.queue)} scans wait; "
                            "expected a faster reconstructor or longer cycles")
                    for other in given_up]
        # What is heard from now on belongs to the next cycle.
        return [*problems, *self.close_scan(scan),
                ScanOpened(QueuedScan("cycle", scan.part))]
