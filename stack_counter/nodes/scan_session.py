# SPDX-License-Identifier: Apache-2.0
"""When a scan begins and ends, which views are its own, and when each may be sent. No ROS.

What differs by mode is in `scan_modes.py`. Methods return events for the node to carry out.
"""

from __future__ import annotations

import time
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

from stack_counter.errors import ScanError
from stack_counter.nodes.scan_events import (
    Problem,
    ScanClosed,
    ScanEvent,
    ScanOpened,
    ScanSent,
    ViewReady,
    ViewsDecided,
)
from stack_counter.nodes.scan_queue import QueuedScan, ScanQueue
from stack_counter.types import PartRequest, Reason, View, ViewTally


@dataclass(frozen=True)
class ScanSessionSettings:
    """How patient a session is; all chosen.

    Attributes:
        announce_again_s: the end of a scan is announced again after this time, seconds, until
            the reconstructor answers.
        lost_after_ticks: the reconstructor may report for so many calls of the timer that it is
            without a scan that was sent before its views count as lost: it started anew. It
            reports every 0.2 s; time alone would pass while either of us stands still.
        many_scans: more scans than these waiting are a problem to name.
        late_tick_s: a call of the timer that comes so long after the one before, seconds, comes
            from a node that stood still: twice the timer's period.
    """

    announce_again_s: float = 2.0
    lost_after_ticks: int = 50
    many_scans: int = 2
    late_tick_s: float = 0.2


SETTINGS = ScanSessionSettings()


class ViewSource(Protocol):
    """Assembles the views of all cameras."""

    @property
    def tally(self) -> ViewTally:
        """Images received, views accepted, and images skipped by reason."""
        ...

    def start(self) -> None:
        """Begins a new scan."""
        ...

    def poll(self) -> list[tuple[str, View]]:
        """Returns the views that are complete now, with their cameras' names."""
        ...

    def flush(self) -> list[tuple[str, View]]:
        """Decides all images that wait."""
        ...


class ScanSession(ABC):
    """Takes views from a source into scans, and lets them go one scan after the other.

    Attributes:
        needs_no_request: images are taken from activation on, without `start_scan`.
        accepting_images: images are taken into a scan.
        reconstructor_ready: the reconstructor is known to receive posed images.
        scan: the scan that is open or was closed last.
        last_closed: the scan that was closed last.
        requested_part: gives the part that a new scan is of.
        late: views that came too late for their cycle, by reason.
        queue: scans whose views wait or are on their way.
    """

    needs_no_request = False

    def __init__(self, source: ViewSource, requested_part: Callable[[], PartRequest],
                 clock: Callable[[], float] = time.monotonic):
        """Makes an idle session.

        Args:
            source: assembles views.
            requested_part: the part that a new scan is of.
            clock: monotonic time, seconds.
        """
        self._source, self._clock = source, clock
        self.requested_part = requested_part
        self.queue = ScanQueue()
        self.scan: QueuedScan | None = None
        self.last_closed: QueuedScan | None = None
        self.accepting_images = self.reconstructor_ready = False
        self._tally_before = ViewTally()  # of the source, when the last scan was closed
        self.late: Counter[str] = Counter()
        self._announced_at = self._ticked_at = 0.0
        # The reconstructor reports that it has no scan, though views of one were sent.
        self._unknown_ticks, self._unknown_since_tick = 0, False

    @property
    def tally(self) -> ViewTally:
        """Tally of the images since the last scan was closed."""
        now, then = self._source.tally, self._tally_before
        skipped = Counter(now.skipped) + self.late - Counter(then.skipped)
        return ViewTally(now.received - then.received, now.used - then.used, dict(skipped))

    @property
    def open_scan_id(self) -> str:
        """Id of the scan that `start` opened; empty where it gets its id later."""
        return self.scan.scan_id if self.scan else ""

    def check_startable(self) -> None:  # noqa: B027  (two of three modes can always start)
        """Refuses to start while a scan is open that does not end by itself.

        Raises:
            ScanError: such a scan is open.
        """

    @abstractmethod
    def start(self, scan_id: str = "") -> list[ScanEvent]:
        """Takes images from now on; see `check_startable`.

        Args:
            scan_id: id of the scan to open; empty: one is made up.
        """

    @abstractmethod
    def add_view(self, camera: str, view: View) -> list[ScanEvent]:
        """Takes one view into a scan."""

    def close_waiting(self, expired_only: bool) -> list[ScanEvent]:
        """Closes the cycles that wait for a camera: all, or those that have waited too long."""
        return []

    @abstractmethod
    def end_on_request(self, scan: QueuedScan) -> list[ScanEvent]:
        """Does what `stop_scan` asks, once all images are decided."""

    def start_by_itself(self) -> list[ScanEvent]:
        """Takes images from now on where the mode needs no request for it."""
        return self.start() if self.needs_no_request and not self.accepting_images else []

    def stop(self) -> list[ScanEvent]:
        """Decides all images that wait and closes the scan.

        Raises:
            ScanError: no scan is open, or no image has come.
        """
        if not self.accepting_images:
            raise ScanError("no scan is open; expected start_scan first")
        events = self._add_and_send(self._source.flush()) + self.close_waiting(expired_only=False)
        if self.scan is None:
            raise ScanError("no image has come since the start; expected a cycle")
        return events + self.end_on_request(self.scan)

    def collect_views(self) -> list[ScanEvent]:
        """Takes the views that are complete and sends what the reconstructor has room for."""
        if not self.accepting_images:
            return []
        before = self._source.tally
        events = self._add_and_send(self._source.poll())
        return [*events, self._views_decided()] if self._source.tally != before else events

    def on_timer(self, message_since_tick: bool) -> list[ScanEvent]:
        """Gives up cycles that have waited too long, and announces an end again.

        Args:
            message_since_tick: a message of a camera was handled since the last call. Then images
                may lie in our own queues, and it is we who are late: no cycle is given up.
                Neither is one by the first call after the node stood still.
        """
        events, now = self.collect_views(), self._clock()
        is_late, self._ticked_at = now - self._ticked_at > SETTINGS.late_tick_s, now
        if not (message_since_tick or is_late) \
                and (closed := self.close_waiting(expired_only=True)):
            events += [*closed, self._views_decided()]
        self._unknown_ticks += self._unknown_since_tick
        self._unknown_since_tick = False
        first = self.queue.first
        if first is not None and self._unknown_ticks > SETTINGS.lost_after_ticks:
            events += [self._mark_scan_lost(first), *self.send_due()]
        elif first is not None and first.reported and self.reconstructor_ready \
                and self._clock() - self._announced_at > SETTINGS.announce_again_s:
            events.append(self._announce_end(first))
        return events

    def on_reconstructor_status(self, scan_id: str, received: int, is_idle: bool,
                                is_stopped: bool) -> list[ScanEvent]:
        """Takes in what the reconstructor reports.

        Args:
            scan_id: the scan that it works on; empty where it is idle.
            received: views of it that have arrived.
            is_idle: it has no scan.
            is_stopped: it is done with the scan.
        """
        self.reconstructor_ready = True
        scan = self.queue.first
        if scan is not None and scan_id == scan.scan_id:
            self._unknown_ticks, self._unknown_since_tick = 0, False
            scan.processed = received
            if is_stopped:
                self.queue.remove_finished(scan.scan_id)
        elif scan is not None and is_idle and (scan.reported or scan.sent > scan.processed):
            self._unknown_since_tick = True
        return self.send_due()

    def problems(self) -> list[str]:
        """Names what waits too long, one line each."""
        first, lines = self.queue.first, []
        if first is not None and first.waiting and not self.reconstructor_ready:
            lines.append(f"{len(first.waiting)} views wait for a reconstructor")
        if len(self.queue) > SETTINGS.many_scans:
            lines.append(f"{len(self.queue)} scans wait: the cycles are too fast")
        return lines

    def status_values(self) -> dict[str, object]:
        """Returns the scan, what waits, and the tally of its images by name."""
        first, tally = self.queue.first, self.tally
        return {"scan": self.scan.scan_id if self.scan else "",
                "views waiting": len(first.waiting) if first else 0,
                "scans waiting": len(self.queue), "images received": tally.received,
                "views accepted": tally.used,
                **{f"skipped: {reason}": n for reason, n in tally.skipped.items()}}

    # --- for the modes ------------------------------------------------------------------------

    def begin_scan(self, scan: QueuedScan | None, recorded_as: QueuedScan) -> list[ScanEvent]:
        """Takes images from now on: into this scan, or, if None, into cycles."""
        self._source.start()
        self._tally_before, self.late = ViewTally(), Counter()
        self.scan, self.accepting_images = scan, True
        if scan is not None:
            self.queue.enqueue(scan)
        return [ScanOpened(recorded_as), self._views_decided()]

    def close_scan(self, scan: QueuedScan) -> list[ScanEvent]:
        """Ends a scan; the reconstructor is told when it is this scan's turn."""
        scan.tally, scan.closed = self.tally, True
        self._tally_before, self.late = self._source.tally, Counter()
        self.scan = self.last_closed = scan
        return [ScanClosed(scan), *self.send_due()]

    def send_due(self) -> list[ScanEvent]:
        """Sends views that the reconstructor has room for, and then the end of the scan."""
        events: list[ScanEvent] = []
        while self.reconstructor_ready and (due := self.queue.take_due_view()) is not None:
            events.append(ViewReady(*due))
        scan = self.queue.first
        if scan is not None and scan.closed and not scan.reported:
            events.append(self._announce_end(scan))
        return events

    # --- details ------------------------------------------------------------------------------

    def _add_and_send(self, views: Sequence[tuple[str, View]]) -> list[ScanEvent]:
        """Takes views into their scans and sends what is due."""
        events = [event for camera, view in views for event in self.add_view(camera, view)]
        return events + self.send_due()

    def _views_decided(self) -> ViewsDecided:
        """Returns the event that publishes the progress of the open scan."""
        return ViewsDecided(None if self.scan is None or self.scan.closed else self.scan)

    def _announce_end(self, scan: QueuedScan) -> ScanSent:
        """Announces how many views there are; the reconstructor may not have heard before."""
        scan.reported, self._announced_at = True, self._clock()
        return ScanSent(scan)

    def _mark_scan_lost(self, scan: QueuedScan) -> Problem:
        """Counts the views that were sent as lost: the reconstructor is without them too long."""
        scan.lost[Reason.VIEWS_LOST.value] += scan.sent
        scan.sent, scan.processed, scan.reported = 0, 0, False
        self._unknown_ticks = 0
        return Problem(f"scan '{scan.scan_id}': the reconstructor has none of its views; "
                       "expected them: it started anew")
