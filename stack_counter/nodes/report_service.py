# SPDX-License-Identifier: Apache-2.0
"""Service `write_report`: pictures and files of the last count, below a folder of our choice.

Offered by the reconstructor, not by the counter: only it has the mesh, which no message carries.
"""

from __future__ import annotations

import re
import time
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from stack_counter_msgs.msg import StackCount as StackCountMsg
from std_srvs.srv import Trigger

from stack_counter.config import ReconstructorConfig
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.report import write_report
from stack_counter.errors import ScanError
from stack_counter.ros.conversions import from_stack_count
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import LATCHED_ALL, RELIABLE
from stack_counter.ros.verdicts import verdict_name
from stack_counter.types import StackCount, StackVolume
from stack_counter.views.decoding import stamp_ns


@dataclass(frozen=True)
class ReportSettings:
    """Limits of the report service; all are chosen.

    Attributes:
        max_waiting: volumes of one region that wait for their counts; older ones are forgotten.
        max_scan_letters: letters of a scan's id in the name of its folder.
    """

    max_waiting: int = 4
    max_scan_letters: int = 40


SETTINGS = ReportSettings()


@dataclass(frozen=True, eq=False)
class WaitingVolume:
    """A volume that was published and is not counted yet.

    Attributes:
        scan_id: scan that the volume belongs to.
        final: the scan has ended.
        volume: with its mesh.
    """

    scan_id: str
    final: bool
    volume: StackVolume


@dataclass(eq=False)
class ReportedScan:
    """The counts that a report is written of.

    Attributes:
        scan_id: scan that the counts belong to.
        counts: by region, "" where none is named; with their volumes and meshes, and what the
            report names beside them.
        folder: of the report; None while that is not written.
    """

    scan_id: str
    counts: dict[str, tuple[StackCount, ReportSubject]]
    folder: Path | None = None


class ReportService:
    """Brings each volume together with its count, and writes the last scan's on request."""

    def __init__(self, node: ManagedNode, config: ReconstructorConfig):
        """Offers the service of a node that is being set up.

        Args:
            node: publishes the volumes, one for each of the regions that the settings name.
            config: its settings; they say where reports are written, and are written into them.
        """
        self._folder, self._config = config.report_folder, config
        self._waiting: deque[WaitingVolume] = deque(
            maxlen=SETTINGS.max_waiting * max(1, len(config.regions)))
        self._last = ReportedScan("", {})
        self._error = "nothing was counted yet; expected a scan and a counter"
        node.subscribe(StackCountMsg, "result", self._on_count, LATCHED_ALL)
        node.subscribe(StackCountMsg, "running_count", self._on_count, RELIABLE)
        node.add_service(Trigger, "write_report", self._on_write_report)

    def keep_volume(self, scan_id: str, final: bool, volume: StackVolume) -> None:
        """Keeps a volume that was published until its count comes."""
        self._waiting.append(WaitingVolume(scan_id, final, volume))

    def _on_count(self, message: StackCountMsg) -> None:
        # Forget what failed.
        if message.error:
            self._forget(message)
            return
        # Find the volume; there is none of a latched count from before this node started.
        key = (message.scan_id, message.final, message.region, stamp_ns(message.header.stamp))
        keys = [(w.scan_id, w.final, w.volume.region, w.volume.stamp_ns) for w in self._waiting]
        if key not in keys:
            return
        # Counts come in the order of their volumes: forget those before it.
        for _ in range(keys.index(key) + 1):
            volume = self._waiting.popleft().volume
        subject = ReportSubject(message.scan_id, message.part, verdict_name(message),
                                settings={"reconstructor": self._config})
        self._keep_counts(message.scan_id, {
            message.region: (from_stack_count(message, volume), subject)})

    def _keep_counts(self, scan_id: str,
                     counts: Mapping[str, tuple[StackCount, ReportSubject] | None]) -> None:
        """Takes counts into those of the scan, in place of another scan's; None for one to go."""
        others = self._last.counts if self._last.scan_id == scan_id else {}
        self._last = ReportedScan(scan_id, {region: count for region, count in
                                            {**others, **counts}.items() if count is not None})

    def _forget(self, failed: StackCountMsg) -> None:
        """Forgets what there is of the region, or of the scan, that gives no count."""
        of_region = f", region {failed.region}" if failed.region else ""
        self._error = f"scan '{failed.scan_id}'{of_region}: {failed.error}"
        self._waiting = deque((w for w in self._waiting if w.scan_id != failed.scan_id or (
            failed.region and failed.region != w.volume.region)), self._waiting.maxlen)
        gone = [failed.region] if failed.region else [*self._last.counts]
        self._keep_counts(failed.scan_id, dict.fromkeys(gone))

    def _on_write_report(self, request: Trigger.Request, response: Trigger.Response
                         ) -> Trigger.Response:
        try:
            response.message = str(self._write_last())
            response.success = True
        except (ScanError, OSError) as error:
            response.message = f"no report: {error}"
        return response

    def _write_last(self) -> Path:
        """Writes the report of the last scan, once for all requests; returns its folder.

        Raises:
            ScanError: there is no folder or no count to write.
            OSError: the folder cannot be written.
        """
        if not self._folder:
            raise ScanError("parameter report_folder is ''; expected a folder to write into")
        ended = [w.scan_id for w in self._waiting if w.final]
        if ended:
            raise ScanError(f"scan '{ended[-1]}' is not counted yet; expected its count from the "
                            "counter")
        if not self._last.counts:
            raise ScanError(self._error)
        if self._last.folder is None or not self._last.folder.is_dir():
            counts = self._last.counts
            folder = new_folder(Path(self._folder).expanduser().resolve(), self._last.scan_id,
                                max(count.volume.stamp_ns for count, _ in counts.values()))
            for region, (count, subject) in counts.items():
                write_report(folder / region, count, [], subject)
            self._last.folder = folder
        return self._last.folder


def new_folder(base: Path, scan_id: str, stamp_ns: int) -> Path:
    """Makes a folder directly below `base`, named by time (UTC) and scan, as recordings are.

    Args:
        base: made if it is not there.
        scan_id: comes from a message: all but letters, digits, - and _ is replaced, and it is
            cut.
        stamp_ns: stamp of the data, ns.

    Raises:
        OSError: the folder cannot be made.
    """
    # Name the folder.
    seconds, rest_ns = divmod(stamp_ns, 10**9)
    date = time.strftime("%Y%m%d-%H%M%S", time.gmtime(seconds))
    scan = re.sub(r"[^A-Za-z0-9_-]+", "-", scan_id)[:SETTINGS.max_scan_letters] or "scan"
    name = f"report_{date}-{rest_ns // 10**6:03d}_{scan}"
    # Make it, under another name where there is one of another scan.
    base.mkdir(parents=True, exist_ok=True)
    folder, number = base / name, 1
    while True:
        try:
            folder.mkdir()
            return folder
        except FileExistsError:
            number += 1
            folder = base / f"{name}-{number}"
