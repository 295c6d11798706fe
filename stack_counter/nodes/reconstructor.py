# SPDX-License-Identifier: Apache-2.0
"""Reconstructor node: `posed_images` in, `volume` out when the scan ends."""

from __future__ import annotations

import math
import time
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace

from stack_counter_msgs.msg import PosedImage, ScanStatus, StackVolume
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ViewError
from stack_counter.nodes.display import Display
from stack_counter.nodes.report_service import ReportService
from stack_counter.nodes.scan_arrival import SETTINGS as ARRIVAL
from stack_counter.nodes.scan_arrival import ScanArrival
from stack_counter.nodes.scan_lines import views_line
from stack_counter.region_counters import RegionCounters, RegionVolume
from stack_counter.ros.conversions import from_posed_image, from_skips, to_stack_volume, to_tally
from stack_counter.ros.diagnostics import WARN, Rate
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.part_fields import from_part_fields, to_part_fields
from stack_counter.ros.qos import LATCHED_ALL, RELIABLE, latched
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import Reason, ViewTally


@dataclass(frozen=True)
class ReconstructorTimes:
    """Periods and time limits of the node; all are chosen.

    Attributes:
        announce_period_s: seconds between two reports to a collector that may just have started.
        stale_after_s: seconds without a view after which the live result is a warning.
        log_period_s: shortest time between two log lines of skipped views, s.
    """

    announce_period_s: float = 0.2
    stale_after_s: float = 10.0
    log_period_s: float = 5.0


TIMES = ReconstructorTimes()


class Reconstructor(ManagedNode[ReconstructorConfig]):
    """Adapter of `RegionCounters`: views come in, a volume of each region goes out."""

    def __init__(self) -> None:
        """Declares the parameters."""
        super().__init__("reconstructor", ReconstructorConfig)

    def setup(self, config: ReconstructorConfig) -> None:
        """Makes an empty reconstruction and connects it."""
        self._config = config
        self._stack = self._next_stack = RegionCounters(config)  # of this scan, of those to come
        self._scan: PosedImage | None = None  # first image of the scan; None between scans
        self._arrival = ScanArrival()  # of the scan's images
        self._finished_scan = ""  # id of the scan that ended last
        self._stopped: ScanStatus | None = None  # the collector's last status of a stopped scan
        self._published_at = 0.0  # s, monotonic
        self._running_volume = math.nan  # of the scan so far, all regions together, m3
        self._image_rate, self._last_view_s = Rate(), 0.0
        self.on_cleanup_call(self._release_scan)
        self._volume = self.advertise(StackVolume, "volume", latched(len(config.regions)))
        self._status = self.advertise(ScanStatus, "scan_status", LATCHED_ALL)
        self._display = Display(self)
        self._reports = ReportService(self, config)
        self._images = self.subscribe(PosedImage, "posed_images", self._on_image, RELIABLE)
        self.subscribe(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.add_service(Trigger, "reset_reconstruction", self._on_reset)
        self.add_timer(ARRIVAL.tick_s, self._on_arrival_tick)
        self.add_timer(TIMES.announce_period_s, self._announce_ready)

    def apply_runtime_config(self, config: ReconstructorConfig) -> None:
        """Has new prompts hold from the next scan on.

        Raises:
            StackCounterError: the prompts cannot be read.
        """
        self._next_stack, self._config = RegionCounters(config), config

    def _release_scan(self) -> None:
        """Frees the memory of the scan."""
        self._stack = self._next_stack = RegionCounters(self._config)
        self._scan = self._stopped = None

    def _announce_ready(self) -> None:
        """Publishes to a collector that images arrive: from here on none is lost."""
        if not self._images.get_publisher_count():
            return
        if self._scan is None:
            self._status.publish(ScanStatus(node="reconstructor", state=ScanStatus.IDLE))
        else:
            self._publish_status()

    # --- the scan -----------------------------------------------------------------------------

    def _on_image(self, message: PosedImage) -> None:
        # The first image has what is counted; the message of the scan's end may come before it.
        is_first = not self._arrival.received
        if self._scan is None or message.scan_id != self._scan.scan_id or is_first:
            self._start_scan(message)
        self._arrival.add_image()
        self._image_rate.tick()
        begin = time.monotonic()
        # Fuse the view.
        try:
            view = from_posed_image(message)
        except ViewError as error:
            self._stack.skip_view(error)
            self._log_skipped(error)
        else:
            try:
                self._stack.add_view(view)
            except ViewError as error:
                self._log_skipped(error)
        # Publish the volume so far. Without depth that takes the time of a whole count: pictures
        # are matched at the end.
        if self._config.live or len(message.depth.data) and self._is_running_due(begin):
            self._publish_volumes(final=False)
            self._published_at = time.monotonic()
        self._last_view_s = time.monotonic() - begin
        self._publish_status()
        self._finish_if_complete()

    def _is_running_due(self, now: float) -> bool:
        """Returns whether the volume so far is published again; `now`: s, monotonic."""
        period = self._config.running_period_s
        return self._stopped is None and 0 < period < now - self._published_at

    def _log_skipped(self, error: ViewError) -> None:
        self.get_logger().warning(f"view skipped: {error}",
                                  throttle_duration_sec=TIMES.log_period_s)

    def _start_scan(self, message: PosedImage) -> None:
        if self._scan is not None and self._scan.scan_id != message.scan_id:
            self._log_lost(f"scan '{message.scan_id}' came before its end")
        self._scan, self._arrival = message, ScanArrival()
        self._published_at, self._running_volume = time.monotonic(), math.nan
        if self._stopped is not None and self._stopped.scan_id != message.scan_id:
            self._stopped = None
        self._stack = self._next_stack
        # It only chooses voxels: a v that cannot be one is refused where the part is counted.
        is_size = math.isfinite(message.unit_volume) and message.unit_volume > 0
        self._stack.start(message.unit_volume if is_size else 0.0)

    def _on_status(self, message: ScanStatus) -> None:
        """Ends the scan that the collector has stopped, once its images are in."""
        if message.node != "collector":
            return
        if message.state != ScanStatus.STOPPED:
            if message.scan_id == self._finished_scan:
                self._finished_scan = ""  # another scan of the same name
            return
        # The collector repeats a stop until the end of the reconstruction is published.
        if message.scan_id == self._finished_scan:
            self._status.publish(ScanStatus(node="reconstructor", scan_id=message.scan_id,
                                            state=ScanStatus.STOPPED))
            return
        self._stopped = message
        # A scan of which no image has come is one without views.
        if self._scan is None or self._scan.scan_id != message.scan_id:
            self._start_scan(PosedImage(
                scan_id=message.scan_id, header=message.header,
                world_frame=message.header.frame_id, **to_part_fields(from_part_fields(message))))
        self._arrival.add_stop()
        self._finish_if_complete()

    def _on_arrival_tick(self) -> None:
        """Counts the time that a stopped scan waits for its images."""
        if self._stopped is not None:
            self._arrival.on_tick()
            self._finish_if_complete()

    def _finish_if_complete(self) -> None:
        """Publishes the final volume once all images of a stopped scan have come, or are lost."""
        if self._stopped is None:
            return
        missing = self._stopped.processed - self._arrival.received
        if missing > 0 and not self._arrival.is_given_up:
            return
        self._publish_volumes(final=True)
        self._finished_scan = self._scan.scan_id if self._scan else ""
        self.get_logger().info(views_line(self._finished_scan,
                                          self._scan_tally(self._stack.tally)))
        self._publish_status(ScanStatus.STOPPED)
        self._stopped = self._scan = None  # the next image starts a scan, whatever its id

    def _log_lost(self, why: str) -> None:
        if self._scan is not None:
            self.get_logger().warning(f"scan '{self._scan.scan_id}' lost: {why}")

    def _on_reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._log_lost("reset_reconstruction was called")
        self._scan, self._stopped = None, None
        self._stack.start()
        self._status.publish(ScanStatus(node="reconstructor", state=ScanStatus.IDLE))
        response.success = True
        return response

    # --- what is published --------------------------------------------------------------------

    def _publish_volumes(self, final: bool) -> None:
        """Publishes the volume of every region in the scan so far, and shows them.

        Args:
            final: the scan has ended: of a region that gives no volume the reason is published.
        """
        assert self._scan is not None  # for the type checker
        scan, missing = self._scan, list(self._stopped.missing_cameras) if self._stopped else []
        header, shown = Header(stamp=scan.header.stamp, frame_id=scan.world_frame), []
        for measured in self._stack.volumes(self.get_logger().error):
            volume = measured.volume
            if volume is not None:
                views = self._scan_tally(volume.views)
                if Reason.VIEWS_LOST.value in views.skipped:
                    volume = replace(volume, reasons=volume.reasons + (Reason.VIEWS_LOST,))
                volume = replace(volume, views=views).with_missing_cameras(missing)
                self._volume.publish(to_stack_volume(volume, scan.world_frame, scan, final))
                self._reports.keep_volume(scan.scan_id, final, volume)
                header = to_header(volume.stamp_ns, scan.world_frame)
                shown.append(volume)
            elif final:
                self._publish_failure(measured, missing)
        if shown:
            self._running_volume = sum(volume.stack_volume for volume in shown)
        if shown or final:
            self._display.show_scan(self._stack, shown, header, final)

    def _publish_failure(self, measured: RegionVolume, missing_cameras: list[str]) -> None:
        """Publishes why a region of the scan that has ended gives no volume."""
        assert self._scan is not None  # for the type checker
        scan, views = self._scan, self._scan_tally(measured.tally)
        problems = self._stopped.problems if self._stopped else ()
        lost = views.skipped.get(Reason.VIEWS_LOST.value)
        error = "; ".join([measured.error, *problems])
        if lost:
            error += f"; {Reason.VIEWS_LOST}: {lost} of {views.received} never reached this node"
        self._volume.publish(StackVolume(
            header=Header(stamp=scan.header.stamp, frame_id=scan.world_frame),
            scan_id=scan.scan_id, region=measured.region, final=True, error=error,
            missing_cameras=missing_cameras, views=to_tally(views),
            **to_part_fields(from_part_fields(scan))))

    def _scan_tally(self, tally: ViewTally) -> ViewTally:
        """Returns the tally with the collector's skips and the lost views, once it has stopped."""
        status = self._stopped
        if status is None:
            return tally
        skipped = Counter(from_skips(status))
        if self._arrival.is_given_up:
            skipped[Reason.VIEWS_LOST.value] += status.processed - self._arrival.received
        return ViewTally(status.received, status.processed, skipped) + tally

    def _publish_status(self, state: int = ScanStatus.SCANNING) -> None:
        assert self._scan is not None  # for the type checker
        tally = self._stack.tally
        self._status.publish(ScanStatus(
            header=self._scan.header, node="reconstructor", scan_id=self._scan.scan_id,
            **to_part_fields(from_part_fields(self._scan)), state=state,
            received=self._arrival.received, processed=tally.used,
            skip_reasons=list(tally.skipped), skip_counts=list(tally.skipped.values()),
            coverage=self._stack.coverage, stack_volume=self._running_volume))

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Returns warnings: no collector, or a live result that grows old."""
        if not self._images.get_publisher_count():
            return [(WARN, "nobody publishes posed_images; expected a collector")]
        silent_s = self._image_rate.silent_s
        if self._config.live and self._scan is not None and silent_s > TIMES.stale_after_s:
            return [(WARN, f"no new view for {silent_s:.0f} s: what is published is as old")]
        return []

    def status_values(self) -> Mapping[str, object]:
        """Returns views, skips and times of the scan."""
        tally = self._stack.tally
        return {"scan": self._scan.scan_id if self._scan else "",
                "views Hz": self._image_rate.hz,
                "views received": tally.received, "views used": tally.used,
                "last view s": self._last_view_s,
                "last view age s": self._image_rate.silent_s,
                "coverage": self._stack.coverage, "volume cm3": self._running_volume * 1e6,
                **{f"skipped: {reason}": n for reason, n in tally.skipped.items()}}


def main() -> None:
    """Runs the node."""
    run(Reconstructor)


if __name__ == "__main__":
    main()
