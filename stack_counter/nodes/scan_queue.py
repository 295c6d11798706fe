"""Views on their way to the reconstructor: one scan after the other, a few views at a time."""

from __future__ import annotations

from collections import Counter, deque
from dataclasses import dataclass, field

from stack_counter.types import View, ViewTally

_IN_FLIGHT = 4  # sent, and not yet reported as processed
_WAITING = 60  # of a camera, kept for a reconstructor that is slower
_SCANS = 20  # scans kept, of which all but the first wait


@dataclass
class QueuedScan:
    """One scan: what it is of, its views that wait, and how far it is.

    Attributes:
        scan_id, part, unit_volume: as in `PosedImage`.
        waiting: camera names and views that are not sent yet.
        sent, processed: of its views; `processed` as the reconstructor says.
        closed: no more views will come.
        missing: cameras that gave none.
        tally: of its images; of an open scan as of now.
        lost: views of it that were given up, by reason.
        newest_only: of each camera only the newest view waits, and only one is on its way: who
            follows what happens wants no old pictures.
        reported: the reconstructor has been told how many views there are.
    """

    scan_id: str
    part: str = ""
    unit_volume: float = 0.0
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
        """Of it that reach the reconstructor."""
        return self.sent + len(self.waiting)

    def add(self, camera: str, view: View) -> View | None:
        """One more view; the oldest one of its camera goes, and is returned, if there are too
        many."""
        self.waiting.append((camera, view))
        same = [item for item in self.waiting if item[0] == camera]
        if len(same) > (1 if self.newest_only else _WAITING):
            self.waiting = deque(item for item in self.waiting if item is not same[0])
            self.lost["superseded" if self.newest_only else "overrun"] += 1
            return same[0][1]
        return None

    @property
    def has_room(self) -> bool:
        """Whether another view may be sent."""
        return self.sent - self.processed < (1 if self.newest_only else _IN_FLIGHT)


class ScanQueue:
    """Scans in order. The next one is sent when the reconstructor has finished the one before."""

    def __init__(self) -> None:
        self._scans: deque[QueuedScan] = deque()

    @property
    def first(self) -> QueuedScan | None:
        """The scan that is being sent."""
        return self._scans[0] if self._scans else None

    def __len__(self) -> int:
        return len(self._scans)

    def open(self, scan: QueuedScan) -> list[QueuedScan]:
        """Queues a scan; returns those that were given up for it."""
        self._scans.append(scan)
        dropped = []
        while len(self._scans) > _SCANS:
            dropped.append(self._scans[1])
            del self._scans[1]
        return dropped

    def finished(self, scan_id: str) -> None:
        """The reconstructor is done with a scan."""
        while self._scans and self._scans[0].closed and self._scans[0].scan_id == scan_id:
            self._scans.popleft()

    def due(self) -> tuple[QueuedScan, str, View] | None:
        """The next view to send, if there is room for it."""
        scan = self.first
        if scan is None or not scan.waiting or not scan.has_room:
            return None
        camera, view = scan.waiting.popleft()
        scan.sent += 1
        return scan, camera, view

    def clear(self) -> None:
        """Forgets all scans."""
        self._scans.clear()
