"""Service `write_report`: pictures and files of the last count, below a folder of our choice.

Offered by the reconstructor, not by the counter: only it has the mesh, which no message carries.
"""

from __future__ import annotations

import re
import time
from collections import deque
from pathlib import Path

from stack_counter_msgs.msg import StackCount as StackCountMsg
from std_srvs.srv import Trigger

from stack_counter.display.report import write_report
from stack_counter.errors import ScanError
from stack_counter.ros.conversions import from_stack_count
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import LATCHED
from stack_counter.types import StackCount, StackVolume
from stack_counter.views.decoding import stamp_ns

_AHEAD = 4  # volumes that wait for their counts
_LONGEST = 40  # letters of a scan's id in the name of its folder


class ReportService:
    """Brings each volume together with its count."""

    def __init__(self, node: ManagedNode, folder: str):
        """Offers the service; `folder` as the parameter `report_folder`."""
        self._folder = folder
        # Volumes that are not counted yet, with their scan and whether they are its last.
        self._waiting: deque[tuple[str, bool, StackVolume]] = deque(maxlen=_AHEAD)
        self._last: tuple[str, StackCount] | None = None  # scan id and count
        self._written: Path | None = None  # its report
        self._error = "nothing was counted yet; expected a scan and a counter"
        node.subscribe(StackCountMsg, "count", self._on_count, LATCHED)
        node.add_service(Trigger, "write_report", self._write)

    def keep(self, scan_id: str, final: bool, volume: StackVolume) -> None:
        """A volume was published; its count will follow."""
        self._waiting.append((scan_id, final, volume))

    def _on_count(self, message: StackCountMsg) -> None:
        if message.error:
            self._last, self._written = None, None
            self._error = f"scan '{message.scan_id}': {message.error}"
            self._waiting = deque((w for w in self._waiting if w[0] != message.scan_id), _AHEAD)
            return
        key = message.scan_id, message.final, stamp_ns(message.header.stamp)
        keys = [(scan_id, final, volume.stamp_ns) for scan_id, final, volume in self._waiting]
        if key not in keys:  # a latched count of the time before this node
            return
        for _ in range(keys.index(key) + 1):  # counts come in the order of their volumes
            *_, volume = self._waiting.popleft()
        self._last = message.scan_id, from_stack_count(message, volume)
        self._written = None

    def _write(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        try:
            response.message = str(self._report())
            response.success = True
        except (ScanError, OSError) as error:
            response.message = f"no report: {error}"
        return response

    def _report(self) -> Path:
        """The folder of the report; it is written once, however often it is asked for.

        Raises:
            ScanError: there is no folder or no count to write.
            OSError: the folder cannot be written.
        """
        if not self._folder:
            raise ScanError("parameter report_folder is ''; expected a folder to write into")
        ended = [scan_id for scan_id, final, _ in self._waiting if final]
        if ended:
            raise ScanError(f"scan '{ended[-1]}' is not counted yet; expected its count from the "
                            "counter")
        if self._last is None:
            raise ScanError(self._error)
        if self._written is None or not self._written.is_dir():
            scan_id, count = self._last
            folder = new_folder(Path(self._folder).expanduser().resolve(), scan_id,
                                count.volume.stamp_ns)
            write_report(folder, count, [])
            self._written = folder
        return self._written


def new_folder(base: Path, scan_id: str, stamp_ns: int) -> Path:
    """Makes a folder directly below `base`, named by time (UTC) and scan, as recordings are.

    Args:
        base: made if it is not there.
        scan_id: came by message: all but letters, digits, - and _ is replaced, and it is cut.
        stamp_ns: of the data, ns.

    Raises:
        OSError: it cannot be made.
    """
    second, rest = divmod(stamp_ns, 10**9)
    when = time.strftime("%Y%m%d-%H%M%S", time.gmtime(second))
    scan = re.sub(r"[^A-Za-z0-9_-]+", "-", scan_id)[:_LONGEST] or "scan"
    name = f"report_{when}-{rest // 10**6:03d}_{scan}"
    base.mkdir(parents=True, exist_ok=True)
    folder, number = base / name, 1
    while True:  # never into the report of another scan
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            number += 1
            folder = base / f"{name}-{number}"
