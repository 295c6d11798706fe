# SPDX-License-Identifier: Apache-2.0
"""Views on their way to the reconstructor: one scan after the other, a few views at a time."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

from stack_counter.types import PartRequest, View, ViewTally


@dataclass(frozen=True)
class ScanQueueSettings:
    """How much is kept for a reconstructor that is slower than the cameras; all chosen.

    Attributes:
        in_flight: views that may be sent and not yet reported as processed.
        waiting_of_camera: views of one camera that may wait.
        scans: scans that are kept; all but the first wait.
    """

    in_flight: int = 4
    waiting_of_camera: int = 60
    scans: int = 20


SETTINGS = ScanQueueSettings()


@dataclass(eq=False)
class QueuedScan:
    """One scan: its part, its views that wait, and how far it is.

    Attributes:
        scan_id: as in `PosedImage`.
        part: that it is asked to be of.
        waiting: camera names and views that are not sent yet.
        sent: number of its views that were sent.
        processed: number of its views that the reconstructor reports as received.
        closed: no more views will come.
        missing: cameras that gave no view.
        tally: tally of its images once it is closed.
        lost: number of its views that were given up, by reason.
        newest_only: only the newest view of each camera waits, and only one is on its way, as
            live counts need no old pictures.
        reported: its end has been announced to the reconstructor.
    """

    scan_id: str
    part: PartRequest = PartRequest()
    waiting: deque[tuple[str, View]] = field(default_factory=deque)
    sent: int = 0
    processed: int = 0
    closed: bool = False
    missing: tuple[str, ...] = ()
    tally: ViewTally = ViewTally()
    lost: Counter[str] = field(default_factory=Counter)
    newest_only: bool = False
    reported: bool = False

    @property
    def views(self) -> int:
        """Number of views of this scan that will reach the reconstructor."""
        return self.sent + len(self.waiting)

    def add(self, camera: str, view: View) -> View | None:
        """Queues one more view.

        Returns:
            The oldest waiting view of the same camera, which is dropped if there are too many;
            else None.
        """
        self.waiting.append((camera, view))
        same = [item for item in self.waiting if item[0] == camera]
        if len(same) > (1 if self.newest_only else SETTINGS.waiting_of_camera):
            self.waiting = deque(item for item in self.waiting if item is not same[0])
            self.lost["superseded" if self.newest_only else "overrun"] += 1
            return same[0][1]
        return None

    @property
    def has_room(self) -> bool:
        """Whether another view may be sent."""
        return self.sent - self.processed < (1 if self.newest_only else SETTINGS.in_flight)


class ScanQueue:
    """Scans in order. The next one is sent when the reconstructor has finished the one before."""

    def __init__(self) -> None:
        """Makes an empty queue."""
        self._scans: deque[QueuedScan] = deque()

    @property
    def first(self) -> QueuedScan | None:
        """The scan whose views are being sent; None if there is none."""
        return self._scans[0] if self._scans else None

    def __len__(self) -> int:
        return len(self._scans)

    def enqueue(self, scan: QueuedScan) -> list[QueuedScan]:
        """Queues a scan and returns those that are given up for it."""
        self._scans.append(scan)
        dropped = []
        while len(self._scans) > SETTINGS.scans:
            dropped.append(self._scans[1])
            del self._scans[1]
        return dropped

    def remove_finished(self, scan_id: str) -> None:
        """Removes a scan that the reconstructor is done with."""
        while self._scans and self._scans[0].closed and self._scans[0].scan_id == scan_id:
            self._scans.popleft()

    def take_due_view(self) -> tuple[QueuedScan, str, View] | None:
        """Takes the next view to send out of the queue: its scan, camera and image.

        None where no view waits, or the reconstructor has no room.
        """
        scan = self.first
        if scan is None or not scan.waiting or not scan.has_room:
            return None
        camera, view = scan.waiting.popleft()
        scan.sent += 1
        return scan, camera, view

    def clear(self) -> None:
        """Forgets all scans."""
        self._scans.clear()
