"""Collector node: camera topics and TF in, `posed_images` of scans out."""

from __future__ import annotations

import time
import uuid
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image
from stack_counter_msgs.msg import PosedImage, ScanStatus
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger
from tf2_msgs.msg import TFMessage

from stack_counter.config import CollectorConfig
from stack_counter.errors import ConfigError, PartError, ViewError
from stack_counter.nodes.scan_queue import QueuedScan, ScanQueue
from stack_counter.nodes.scan_recording import ScanRecording
from stack_counter.parts.catalogue import resolve_part
from stack_counter.ros.conversions import to_posed_image
from stack_counter.ros.diagnostics import WARN, Rate
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.qos import RELIABLE
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import View, ViewTally
from stack_counter.views.cycles import Cycle, CycleGrouper
from stack_counter.views.decoding import stamp_ns
from stack_counter.views.rig import RigAssembler, load_rig

_SILENT_S = 2.0  # without an image while a scan is open: an operator should look
_TELL_AGAIN_S = 2.0
_LOST_S = 3.0  # that the reconstructor has nothing of a scan that was sent: it started anew


class Collector(ManagedNode[CollectorConfig]):
    """Collects the views of scans: between `start_scan` and `stop_scan`, for ever, or of each
    cycle of a rig's cameras."""

    def __init__(self) -> None:
        self._recording = ScanRecording()
        super().__init__("collector", CollectorConfig)

    def setup(self, config: CollectorConfig) -> None:
        """Subscribes to the cameras and offers the scan services."""
        self._config, self._rig = config, load_rig(config)
        self._asked: tuple[str, float] = (config.part, config.unit_volume_m3)
        self._known_part(*self._asked)  # or say why not
        self._assembler = RigAssembler(self._rig)
        self._rates: dict[str, Rate] = {}
        self._tf = Rate()
        self._taken = False  # messages of cameras since the clock was looked at
        self._heard = False  # the reconstructor says that posed images reach it
        self._forget_scans()
        self._recording.configure(config, self.get_logger().warning)
        self.on_cleanup_call(self._recording.close)
        self._inputs = []
        sensor = QoSProfile(depth=30, reliability=ReliabilityPolicy.RELIABLE if config.reliable
                            else ReliabilityPolicy.BEST_EFFORT)
        for topic, takers in self._assembler.takers().items():
            kinds = {"color": CompressedImage if topic.endswith("/compressed") else Image,
                     "info": CameraInfo, "pose": PoseStamped}
            self._inputs.append(self.subscribe(
                kinds.get(takers[0][0], Image), topic, self._taker(topic, takers),
                RELIABLE if takers[0][0] == "pose" else sensor))
        if self._assembler.needs_tf:
            static = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._inputs.append(self.subscribe(
                TFMessage, "/tf", lambda m: self._on_tf(m, False), QoSProfile(depth=1000)))
            self.subscribe(TFMessage, "/tf_static", lambda m: self._on_tf(m, True), static)
        self._posed_images = self.advertise(PosedImage, "posed_images", RELIABLE)
        self._status = self.advertise(ScanStatus, "scan_status", RELIABLE)
        self.subscribe(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.add_service(StartScan, "start_scan", self._start_scan)
        self.add_service(StopScan, "stop_scan", self._stop_scan)
        self.add_service(Trigger, "reset", self._reset)
        self.add_timer(0.1, self._look_at_the_clock)

    def apply_runtime_config(self, config: CollectorConfig) -> None:
        """New gates hold from the next scan on."""
        self._config = config
        for camera, assembler in zip(self._rig.cameras, self._assembler.of.values()):
            assembler.adjust(replace(
                camera.config, min_motion_m=config.min_motion_m,
                min_motion_rad=config.min_motion_rad, min_change=config.min_change,
                min_sharpness=config.min_sharpness))

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile) -> Subscription:
        """As every node; what comes from cameras and TF is recorded."""
        return super().subscribe(kind, topic, self._recording.tap(kind, topic, callback), qos)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """As every node; the recording ends."""
        self._recording.stop("deactivated")
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """The recording ends."""
        self._recording.stop("shutdown")
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """As every node; the recording is finished first."""
        self._recording.close()
        super().destroy_node()

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From now on data is taken; scans that need no asking start."""
        result = super().on_activate(state)
        if self._config.mode != "scan" and not self._open:
            self._begin()
        return result

    def _forget_scans(self) -> None:
        self._outbox = ScanQueue()
        self._scan: QueuedScan | None = None  # the last one: open or just closed
        self._open = False  # images are taken
        self._former = CycleGrouper([c.name for c in self._rig.cameras], self._rig.tolerance_s,
                                    self._rig.timeout_s, live=True)
        self._counted = ViewTally()  # images that earlier cycles account for
        self._late: Counter[str] = Counter()
        self._told_at = 0.0
        self._nothing_since = 0.0  # the reconstructor has no scan though views of one were sent

    # --- data ---------------------------------------------------------------------------------

    def _taker(self, topic: str, takers: list[tuple[str, Callable[[Any], None]]]
               ) -> Callable[[Any], None]:
        rate = self._rates.setdefault(topic, Rate()) if takers[0][0] == "color" else Rate()
        always = takers[0][0] in ("info", "pose")

        def take(message: Any) -> None:
            rate.tick(self._age_s(message.header))
            self._taken = True
            if self._open or always:
                for _, add in takers:
                    add(message)
                self._collect()
        return take

    def _on_tf(self, message: TFMessage, static: bool) -> None:
        for transform in message.transforms:
            self._assembler.add_transform(transform, static)
            if not static:
                self._tf.tick(self._age_s(transform.header))
        self._collect()

    def _age_s(self, header: Any) -> float:
        return (self.get_clock().now().nanoseconds - stamp_ns(header.stamp)) * 1e-9

    def _on_status(self, message: ScanStatus) -> None:
        if message.node != "reconstructor":
            return
        self._heard = True
        scan = self._outbox.first
        if scan is not None and message.scan_id == scan.scan_id:
            self._nothing_since = 0.0
            scan.processed = message.received
            if message.state == ScanStatus.STOPPED:
                self._outbox.finished(scan.scan_id)
        elif scan is not None and message.state == ScanStatus.IDLE \
                and (scan.reported or scan.sent > scan.processed):
            self._lost_on_the_way(scan)
        self._send()

    def _lost_on_the_way(self, scan: QueuedScan) -> None:
        """The reconstructor says that it has no scan: it started anew after views were sent."""
        now = time.monotonic()
        self._nothing_since = self._nothing_since or now
        if now - self._nothing_since > _LOST_S:
            scan.lost["lost"] += scan.sent
            scan.sent, scan.processed, scan.reported = 0, 0, False
            self._nothing_since = 0.0
            self.get_logger().error(f"scan '{scan.scan_id}': the reconstructor has none of its "
                                    "views; expected them: it started anew")

    def _collect(self) -> None:
        """Takes the views that are complete and sends what the reconstructor has room for."""
        if not self._open:
            return
        before = self._assembler.tally
        self._take(self._assembler.poll())
        if self._assembler.tally != before:
            self._report(ScanStatus.SCANNING)

    def _look_at_the_clock(self) -> None:
        """What has waited too long is given up, unless images lie in our own queues: then it is we
        who are late."""
        self._collect()
        self._heard = self._heard and self._posed_images.get_subscription_count() > 0
        if not self._taken:
            for cycle in self._former.expired():
                self._close_cycle(cycle)
        self._taken = False
        first = self._outbox.first
        if first is not None and first.reported and self._heard \
                and time.monotonic() - self._told_at > _TELL_AGAIN_S:
            self._tell(first)

    def _take(self, views: list[tuple[str, View]]) -> None:
        for camera, view in views:
            if self._config.mode != "cycle":
                assert self._scan is not None  # for the type checker
                dropped = self._scan.add(camera, view)
                if dropped is not None:
                    self._recording.overrun(dropped)
                continue
            try:
                for cycle in self._former.add(camera, view):
                    self._close_cycle(cycle)
            except ViewError as error:
                self._late[f"late_{camera}"] += 1
                self.get_logger().warning(str(error), throttle_duration_sec=5.0)
        self._send()

    def _close_cycle(self, cycle: Cycle) -> None:
        """A cycle is a scan of its own, with all its views there."""
        scan = QueuedScan(f"cycle_{cycle.stamp_ns}", *self._part_now())
        for camera in self._former.cameras:
            if camera in cycle.views:
                scan.add(camera, cycle.views[camera])
        scan.missing = tuple(self._former.missing(cycle))
        for dropped in self._outbox.open(scan):
            self.get_logger().error(f"scan '{dropped.scan_id}' given up: {len(self._outbox)} "
                                    "scans wait; expected a faster reconstructor or longer cycles")
        self._close(scan)
        self._recording.start(QueuedScan("cycle", scan.part, scan.unit_volume))  # of the next one

    def _send(self) -> None:
        while self._heard and (due := self._outbox.due()) is not None:
            scan, camera, view = due
            self._posed_images.publish(to_posed_image(
                view, self._config.world_frame, scan.scan_id, scan.part, scan.unit_volume,
                camera))
        scan = self._outbox.first
        if scan is not None and scan.closed and not scan.reported:
            self._tell(scan)

    def _tell(self, scan: QueuedScan) -> None:
        """The reconstructor shall know how many views there are; it may not have heard before."""
        scan.reported, self._told_at = True, time.monotonic()
        self._report(ScanStatus.STOPPED, scan)

    def _report(self, state: int, of: QueuedScan | None = None) -> None:
        scan = of or self._scan
        tally = scan.tally if scan is not None and scan.closed else self._tally()
        skipped = Counter(tally.skipped) + (scan.lost if scan is not None else Counter())
        self._status.publish(ScanStatus(
            header=to_header(self.get_clock().now().nanoseconds, self._config.world_frame),
            node="collector", scan_id=scan.scan_id if scan else "", state=state,
            received=tally.received, processed=scan.views if scan else 0,
            skip_reasons=list(skipped), skip_counts=list(skipped.values()),
            missing_cameras=list(scan.missing) if scan else []))

    def _tally(self) -> ViewTally:
        """Of the images since the last scan was closed."""
        now, then = self._assembler.tally, self._counted
        skipped = Counter(now.skipped) + self._late - Counter(then.skipped)
        return ViewTally(now.received - then.received, now.used - then.used, dict(skipped))

    def _begin(self, scan_id: str = "") -> None:
        """Images are taken from now on; in cycle mode scans are made of them later."""
        self._assembler.start()
        self._counted, self._late = ViewTally(), Counter()
        self._scan, self._open = None, True
        if self._config.mode != "cycle":
            self._scan = QueuedScan(scan_id or uuid.uuid4().hex[:8], *self._part_now(),
                                    newest_only=self._config.mode == "continuous")
            self._outbox.open(self._scan)
        self._recording.start(self._scan or QueuedScan("cycle", *self._part_now()))
        self._report(ScanStatus.SCANNING)

    def _close(self, scan: QueuedScan) -> None:
        """No more views come; the reconstructor hears of it when it is this scan's turn."""
        # All views are decided: what follows is of no scan, or of another.
        self._recording.stop("stop_scan")
        scan.tally, scan.closed = self._tally(), True
        self._counted, self._late = self._assembler.tally, Counter()
        self._scan = scan
        self._send()

    # --- services -----------------------------------------------------------------------------

    def _known_part(self, part: str, unit_volume: float) -> tuple[str, float]:
        """Part and unit volume, m3, that are given; the counter's own where neither is.

        Raises:
            PartError: unknown part, or no positive volume.
        """
        if not (part or unit_volume):
            return part, 0.0
        return part, resolve_part(part, unit_volume, self._config.part_catalogue).unit_volume

    def _part_now(self) -> tuple[str, float]:
        """What was asked for, by the catalogue as it is now; as it was asked if that fails, for
        the counter to say why."""
        try:
            return self._known_part(*self._asked)
        except (PartError, ConfigError) as error:
            self.get_logger().error(str(error))
            return self._asked

    def _start_scan(self, request: StartScan.Request, response: StartScan.Response
                    ) -> StartScan.Response:
        mode = self._config.mode
        if not self.active:
            response.message = "the collector is not active; expected an active node"
            return response
        if self._open and mode == "scan" and self._scan is not None:
            response.scan_id = self._scan.scan_id
            response.message = f"scan '{response.scan_id}' is open; expected none: stop it first"
            return response
        try:
            self._known_part(request.part, request.unit_volume)
            self._asked = request.part, request.unit_volume
        except (PartError, ConfigError) as error:
            response.message = str(error)
            return response
        if mode == "continuous" and self._open and self._scan is not None:
            self._close(self._scan)
        if mode != "cycle" or not self._open:
            self._begin(request.scan_id)
        response.accepted = True  # in cycle mode the next cycle is the scan: it has no name yet
        response.scan_id = self._scan.scan_id if self._scan and mode != "cycle" else ""
        # Asked of the readers: a publisher in the graph may not have been matched yet.
        response.unmatched_topics = [s.topic_name for s in self._inputs
                                     if not s.get_publisher_count()]
        return response

    def _stop_scan(self, request: StopScan.Request, response: StopScan.Response
                   ) -> StopScan.Response:
        if not self._open:
            response.message = "no scan is open; expected start_scan first"
            return response
        self._take(self._assembler.flush())
        for cycle in self._former.flush():
            self._close_cycle(cycle)
        closed = self._scan  # in cycle mode, the last cycle
        if closed is None:
            response.message = "no image has come since the start; expected a cycle"
            return response
        if self._config.mode != "cycle":
            self._open = False
            self._close(closed)
        if self._config.mode == "continuous":  # what goes on is another scan
            self._begin()
        response.accepted, response.scan_id = True, closed.scan_id
        response.published = closed.views
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._forget_scans()
        self._recording.stop("reset")
        self._heard = False  # until it says so again: it may be another one
        self._report(ScanStatus.IDLE)
        if self.active and self._config.mode != "scan":
            self._begin()
        response.success = True
        return response

    # --- diagnostics --------------------------------------------------------------------------

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Silent cameras and TF, views that wait."""
        found = []
        if self._open:
            found += [(WARN, f"no image on {topic} for {rate.silent_s:.0f} s")
                      for topic, rate in self._rates.items() if rate.silent_s > _SILENT_S]
            if self._assembler.needs_tf and self._assembler.waiting and \
                    self._tf.silent_s > _SILENT_S:
                found.append((WARN, f"no /tf for {self._tf.silent_s:.0f} s and images wait for "
                                    "it"))
        first = self._outbox.first
        if first is not None and first.waiting and not self._heard:
            found.append((WARN, f"{len(first.waiting)} views wait for a reconstructor"))
        if len(self._outbox) > 2:
            found.append((WARN, f"{len(self._outbox)} scans wait: the cycles are too fast"))
        return found

    def status_values(self) -> Mapping[str, object]:
        """Rates, latencies, queues, skip reasons."""
        first, tally = self._outbox.first, self._tally()
        return {
            "mode": self._config.mode, "scan": self._scan.scan_id if self._scan else "",
            **{f"{topic} Hz": rate.hz for topic, rate in self._rates.items()},
            **{f"{topic} latency s": rate.latency_s for topic, rate in self._rates.items()},
            "tf Hz": self._tf.hz, "tf age s": self._tf.silent_s,
            "images waiting for partners": self._assembler.waiting,
            "views waiting": len(first.waiting) if first else 0,
            "scans waiting": len(self._outbox), "images received": tally.received,
            "views accepted": tally.used,
            **{f"skipped: {reason}": n for reason, n in tally.skipped.items()}}


def main() -> None:
    """Runs the node."""
    run(Collector)


if __name__ == "__main__":
    main()
