"""Reconstructor node: `posed_images` in, `volume` out when the scan ends."""

from __future__ import annotations

import math
import time
from collections.abc import Mapping
from dataclasses import replace

from stack_counter_msgs.msg import PosedImage, ScanStatus, StackVolume
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.nodes.display import Display
from stack_counter.nodes.report_service import ReportService
from stack_counter.pipeline import StackCounter
from stack_counter.ros.conversions import from_posed_image, to_stack_volume, to_tally
from stack_counter.ros.diagnostics import WARN, Rate
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.qos import LATCHED, RELIABLE
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import Reason, ViewTally

_OLD_S = 10.0  # without a view in continuous mode
_LOST_AFTER_S = 5.0  # a scan that was stopped waits this long for images on their way


class Reconstructor(ManagedNode[ReconstructorConfig]):
    """Drives `StackCounter.add_view` and `.volume`."""

    def __init__(self) -> None:
        super().__init__("reconstructor", ReconstructorConfig)

    def setup(self, config: ReconstructorConfig) -> None:
        """Makes an empty reconstruction and connects it."""
        self._config = config
        self._stack = self._next = StackCounter(config)  # of this scan, and of those to come
        self._scan: PosedImage | None = None  # first image of the scan; None between scans
        self._received = 0
        self._finished = ""  # the scan that ended last
        self._stopped: ScanStatus | None = None
        self._stopped_at = self._ran_at = 0.0
        self._last_volume = math.nan  # of this scan so far, m3
        self._images_in, self._took_s = Rate(), 0.0
        self.on_cleanup_call(self._free)
        self._volume = self.advertise(StackVolume, "volume", LATCHED)
        self._status = self.advertise(ScanStatus, "scan_status", RELIABLE)
        self._display, self._reports = Display(self), ReportService(self, config.report_folder)
        self._images = self.subscribe(PosedImage, "posed_images", self._on_image, RELIABLE)
        self.subscribe(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.add_service(Trigger, "reset_reconstruction", self._reset)
        self.add_timer(0.5, self._finish_if_whole)
        self.add_timer(0.2, self._greet)

    def apply_runtime_config(self, config: ReconstructorConfig) -> None:
        """New prompts hold from the next scan on."""
        self._next, self._config = StackCounter(config), config

    def _free(self) -> None:
        """Gives back the memory of the scan."""
        self._stack = self._next = StackCounter(self._config)
        self._scan = self._stopped = None

    def _greet(self) -> None:
        """Tells a collector that its images arrive: from here on none is lost."""
        if not self._images.get_publisher_count():
            return
        if self._scan is None:
            self._status.publish(ScanStatus(node="reconstructor", state=ScanStatus.IDLE))
        else:
            self._report()

    def _on_image(self, message: PosedImage) -> None:
        # The first image says what is counted; word of the scan's end may have come before it.
        if self._scan is None or message.scan_id != self._scan.scan_id or not self._received:
            self._start(message)
        self._received += 1
        self._images_in.tick()
        begin = time.monotonic()
        try:
            view = from_posed_image(message)
        except ViewError as error:
            self._stack.skip(error)
            self._warn(error)
        else:
            try:
                self._stack.add_view(view)
            except ViewError as error:
                self._warn(error)
        # Without depth it would take the time of a whole count: pictures are matched at the end.
        if self._config.live or len(message.depth.data) and self._is_running_due(begin):
            self._publish_volume(final=False)
            self._ran_at = time.monotonic()
        self._took_s = time.monotonic() - begin
        self._report()
        self._finish_if_whole()

    def _is_running_due(self, now: float) -> bool:
        """Whether a scan that goes on says what it has so far."""
        period = self._config.running_period_s
        return self._stopped is None and 0 < period < now - self._ran_at

    def _warn(self, error: ViewError) -> None:
        self.get_logger().warning(f"view skipped: {error}", throttle_duration_sec=5.0)

    def _start(self, message: PosedImage) -> None:
        self._scan, self._received = message, 0
        self._ran_at, self._last_volume = time.monotonic(), math.nan
        if self._stopped is not None and self._stopped.scan_id != message.scan_id:
            self._stopped = None
        self._stack = self._next
        self._stack.start(message.unit_volume)

    def _on_status(self, message: ScanStatus) -> None:
        if message.node != "collector" or message.state != ScanStatus.STOPPED:
            if message.node == "collector" and message.scan_id == self._finished:
                self._finished = ""  # another scan of that name
            return
        if message.scan_id == self._finished:  # it has not heard that we are
            self._status.publish(ScanStatus(node="reconstructor", scan_id=message.scan_id,
                                            state=ScanStatus.STOPPED))
            return
        if self._stopped is None or self._stopped.scan_id != message.scan_id:
            self._stopped_at = time.monotonic()
        self._stopped = message
        if self._scan is None or self._scan.scan_id != message.scan_id:
            self._start(PosedImage(scan_id=message.scan_id, header=message.header,
                                   world_frame=message.header.frame_id))
        self._finish_if_whole()

    def _finish_if_whole(self) -> None:
        """Publishes the final volume once all images of a stopped scan have come."""
        if self._stopped is None:
            return
        late = time.monotonic() - self._stopped_at > _LOST_AFTER_S
        if self._received < self._stopped.processed and not late:
            return
        self._publish_volume(final=True, lost=self._stopped.processed - self._received)
        self._finished = self._scan.scan_id if self._scan else ""
        self._report(ScanStatus.STOPPED)
        self._stopped = self._scan = None  # the next image begins a scan, whatever its id

    def _publish_volume(self, final: bool, lost: int = 0) -> None:
        assert self._scan is not None  # for the type checker
        scan, frame = self._scan, self._scan.world_frame
        missing = list(self._stopped.missing_cameras) if self._stopped else []
        try:
            volume = self._stack.volume()
        except ScanError as error:
            if final:
                header = Header(stamp=scan.header.stamp, frame_id=frame)
                self._volume.publish(StackVolume(
                    header=header, scan_id=scan.scan_id, final=True, part=scan.part,
                    unit_volume=scan.unit_volume, error=str(error), missing_cameras=missing,
                    views=to_tally(self._tally(self._stack.tally))))
                self._display.show(self._stack, None, header, final)
            return
        if lost > 0:
            volume = replace(volume, reasons=volume.reasons + (Reason.VIEWS_LOST,))
        volume = replace(volume, views=self._tally(volume.views)).without(missing)
        self._last_volume = volume.stack_volume
        self._volume.publish(to_stack_volume(volume, frame, scan, final))
        self._reports.keep(scan.scan_id, final, volume)
        self._display.show(self._stack, volume, to_header(volume.stamp_ns, frame), final)

    def _tally(self, used: ViewTally) -> ViewTally:
        """The scan's tally with what the collector skipped, once it is stopped."""
        if self._stopped is None:
            return used
        status = self._stopped
        skipped = dict(zip(status.skip_reasons, (int(n) for n in status.skip_counts)))
        return ViewTally(status.received, status.processed, skipped) + used

    def _report(self, state: int = ScanStatus.SCANNING) -> None:
        tally = self._stack.tally
        assert self._scan is not None  # for the type checker
        self._status.publish(ScanStatus(
            header=self._scan.header, node="reconstructor", scan_id=self._scan.scan_id,
            state=state, received=self._received, processed=tally.used,
            skip_reasons=list(tally.skipped), skip_counts=list(tally.skipped.values()),
            coverage=self._stack.coverage, stack_volume=self._last_volume))

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._scan, self._stopped = None, None
        self._stack.start()
        self._status.publish(ScanStatus(node="reconstructor", state=ScanStatus.IDLE))
        response.success = True
        return response

    def status_lines(self) -> list[tuple[bytes, str]]:
        """A collector that is silent, a scan that grows old."""
        if not self._images.get_publisher_count():
            return [(WARN, "nobody publishes posed_images; expected a collector")]
        if self._config.live and self._scan is not None and self._images_in.silent_s > _OLD_S:
            return [(WARN, f"no new view for {self._images_in.silent_s:.0f} s: what is published "
                           "is as old")]
        return []

    def status_values(self) -> Mapping[str, object]:
        """Views, skips and times of the scan."""
        tally = self._stack.tally
        return {"scan": self._scan.scan_id if self._scan else "", "views Hz": self._images_in.hz,
                "views received": tally.received, "views used": tally.used,
                "last view s": self._took_s, "last view age s": self._images_in.silent_s,
                "coverage": self._stack.coverage, "volume cm3": self._last_volume * 1e6,
                **{f"skipped: {reason}": n for reason, n in tally.skipped.items()}}


def main() -> None:
    """Runs the node."""
    run(Reconstructor)


if __name__ == "__main__":
    main()
