"""Collector node: camera topics and TF in, `posed_images` of one scan out."""

from __future__ import annotations

import uuid
from collections import Counter, deque
from collections.abc import Callable
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

from stack_counter.assembler import ViewAssembler
from stack_counter.config import CollectorConfig
from stack_counter.nodes.base import RELIABLE, ManagedNode, run
from stack_counter.nodes.conversions import to_header, to_posed_image
from stack_counter.nodes.recording import ScanRecording
from stack_counter.types import View

_IN_FLIGHT = 4  # posed images sent that the reconstructor has not yet reported as processed
_WAITING = 60  # posed images kept for a reconstructor that is slower than the camera


class Collector(ManagedNode[CollectorConfig]):
    """Collects the views of a scan between `start_scan` and `stop_scan`."""

    def __init__(self) -> None:
        self._recording = ScanRecording()
        super().__init__("collector", CollectorConfig)

    def setup(self, config: CollectorConfig) -> None:
        """Subscribes to one camera and offers the scan services."""
        self._config = config
        self._assembler = ViewAssembler(config)
        self._forget_scan()
        self._recording.configure(config, self.get_logger().warning)
        self.undo_with(self._recording.close)
        sensor = QoSProfile(depth=30, reliability=ReliabilityPolicy.RELIABLE if config.reliable
                            else ReliabilityPolicy.BEST_EFFORT)
        kind = CompressedImage if config.color_transport == "compressed" else Image
        suffix = "/compressed" if config.color_transport == "compressed" else ""
        self._inputs = [
            self.subscribe(kind, config.color_topic + suffix, self._on_color, sensor),
            self.subscribe(CameraInfo, config.camera_info_topic,
                           self._assembler.add_camera_info, sensor)]
        if config.depth_topic:
            self._inputs.append(self.subscribe(Image, config.depth_topic, self._on_depth, sensor))
        if config.labels_topic:
            self._inputs.append(self.subscribe(Image, config.labels_topic, self._on_labels,
                                               sensor))
        if config.pose_source == "topic":
            self._inputs.append(self.subscribe(PoseStamped, config.pose_topic, self._on_pose,
                                               RELIABLE))
        else:
            static = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
            self._inputs.append(self.subscribe(
                TFMessage, "/tf", lambda m: self._on_tf(m, False), QoSProfile(depth=1000)))
            self.subscribe(TFMessage, "/tf_static", lambda m: self._on_tf(m, True), static)
        self._heard = False  # the reconstructor says that posed images reach it
        self._posed_images = self.advertise(PosedImage, "posed_images", RELIABLE)
        self._status = self.advertise(ScanStatus, "scan_status", RELIABLE)
        self.subscribe(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.serve(StartScan, "start_scan", self._start_scan)
        self.serve(StopScan, "stop_scan", self._stop_scan)
        self.serve(Trigger, "reset", self._reset)
        self.tick(0.1, self._collect)

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

    def _forget_scan(self) -> None:
        self._scan: PosedImage | None = None  # id, part and unit volume of the last scan
        self._open = False  # images are taken
        self._outbox: deque[View] = deque()
        self._sent = self._processed = 0
        self._lost: Counter[str] = Counter()

    # --- data ---------------------------------------------------------------------------------

    def _on_color(self, message: Image | CompressedImage) -> None:
        if self._open:
            self._assembler.add_color(message)
            self._collect()

    def _on_depth(self, message: Image) -> None:
        if self._open:
            self._assembler.add_depth(message)
            self._collect()

    def _on_labels(self, message: Image) -> None:
        if self._open:
            self._assembler.add_labels(message)
            self._collect()

    def _on_pose(self, message: PoseStamped) -> None:
        self._assembler.add_pose(message)
        self._collect()

    def _on_tf(self, message: TFMessage, static: bool) -> None:
        for transform in message.transforms:
            self._assembler.add_transform(transform, static)
        self._collect()

    def _on_status(self, message: ScanStatus) -> None:
        if message.node != "reconstructor":
            return
        self._heard = True
        if self._scan is not None and message.scan_id == self._scan.scan_id:
            self._processed = message.received
        self._send()

    def _collect(self) -> None:
        """Takes the views that are complete and sends what the reconstructor has room for."""
        if not self._open:
            return
        before = self._assembler.tally
        self._take(self._assembler.poll())
        if self._assembler.tally != before:
            self._report(ScanStatus.SCANNING)

    def _take(self, views: list[View]) -> None:
        self._outbox.extend(views)
        while len(self._outbox) > _WAITING:
            self._recording.overrun(self._outbox.popleft())
            self._lost["overrun"] += 1
        self._send()

    def _send(self) -> None:
        scan = self._scan
        while scan is not None and self._outbox and self._sent - self._processed < _IN_FLIGHT \
                and self._heard:
            self._posed_images.publish(to_posed_image(
                self._outbox.popleft(), self._config.world_frame, scan.scan_id, scan.part,
                scan.unit_volume))
            self._sent += 1

    def _report(self, state: int) -> None:
        tally = self._assembler.tally
        skipped = Counter(tally.skipped) + self._lost
        self._status.publish(ScanStatus(
            header=to_header(self.get_clock().now().nanoseconds, self._config.world_frame),
            node="collector", scan_id=self._scan.scan_id if self._scan else "", state=state,
            received=tally.received, processed=self._sent + len(self._outbox),
            skip_reasons=list(skipped), skip_counts=list(skipped.values())))

    # --- services -----------------------------------------------------------------------------

    def _start_scan(self, request: StartScan.Request, response: StartScan.Response
                    ) -> StartScan.Response:
        if not self.active:
            response.message = "the collector is not active; expected an active node"
            return response
        if self._scan is not None and (self._open or self._outbox):
            response.scan_id = self._scan.scan_id
            response.message = f"scan '{response.scan_id}' is open; expected none: stop it first"
            return response
        self._forget_scan()
        self._assembler.start()
        self._scan = PosedImage(scan_id=request.scan_id or uuid.uuid4().hex[:8],
                                part=request.part, unit_volume=request.unit_volume)
        self._open = True
        self._recording.start(self._scan)
        self._report(ScanStatus.SCANNING)
        response.accepted, response.scan_id = True, self._scan.scan_id
        # Asked of the readers: a publisher in the graph may not have been matched yet.
        response.unmatched_topics = [s.topic_name for s in self._inputs
                                     if not s.get_publisher_count()]
        return response

    def _stop_scan(self, request: StopScan.Request, response: StopScan.Response
                   ) -> StopScan.Response:
        if self._scan is None or not self._open:
            response.message = "no scan is open; expected start_scan first"
            return response
        self._take(self._assembler.flush())
        self._open = False
        self._recording.stop("stop_scan")  # all views are decided: what follows is of no scan
        response.accepted, response.scan_id = True, self._scan.scan_id
        response.published = self._sent + len(self._outbox)
        self._report(ScanStatus.STOPPED)
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._forget_scan()
        self._recording.stop("reset")
        self._report(ScanStatus.IDLE)
        response.success = True
        return response


def main() -> None:
    """Runs the node."""
    run(Collector)


if __name__ == "__main__":
    main()
