# SPDX-License-Identifier: Apache-2.0
"""Collector node: camera topics and TF in, `posed_images` of scans out."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

from rclpy.lifecycle import LifecycleState, TransitionCallbackReturn
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from stack_counter_msgs.msg import PosedImage, ScanStatus
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter.config import CollectorConfig
from stack_counter.errors import ConfigError, PartError, ScanError
from stack_counter.nodes import scan_events
from stack_counter.nodes.camera_topics import CameraTopics
from stack_counter.nodes.requested_part import RequestedPart
from stack_counter.nodes.scan_lines import forgotten_line, opened_line
from stack_counter.nodes.scan_modes import make_session
from stack_counter.nodes.scan_queue import QueuedScan
from stack_counter.nodes.scan_recording import ScanRecording
from stack_counter.parts.part_lookup import configured_part
from stack_counter.ros.bad_requests import check_names
from stack_counter.ros.conversions import to_posed_image
from stack_counter.ros.diagnostics import WARN
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.part_fields import from_part_fields, to_part_fields
from stack_counter.ros.qos import LATCHED_ALL, RELIABLE
from stack_counter.ros.standard_messages import to_header
from stack_counter.types import PartRequest
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


class Collector(ManagedNode[CollectorConfig]):
    """Publishes the posed images of scans; a `ScanSession` decides what belongs to which scan."""

    def __init__(self) -> None:
        """Makes an unconfigured node."""
        self._recording = ScanRecording()
        super().__init__("collector", CollectorConfig)

    def setup(self, config: CollectorConfig) -> None:
        """Subscribes to the cameras and offers the scan services."""
        self._config, self._rig = config, load_rig(config)
        self._part = RequestedPart(configured_part(config), config.part_catalogue,
                                   self.get_logger().error)
        self._assembler = RigAssembler(self._rig)
        self._session = make_session(config.mode, self._rig, self._assembler,
                                     self._part.look_up)
        self._recording.configure(config, self.get_logger().warning)
        self.on_cleanup_call(self._recording.close)
        self._topics = CameraTopics(self, self._assembler, config.reliable,
                                    lambda: self._session.accepting_images,
                                    lambda: self._carry_out(self._session.collect_views()))
        self._posed_images = self.advertise(PosedImage, "posed_images", RELIABLE)
        self._status = self.advertise(ScanStatus, "scan_status", LATCHED_ALL)
        self.subscribe(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.add_service(StartScan, "start_scan", self._start_scan)
        self.add_service(StopScan, "stop_scan", self._stop_scan)
        self.add_service(Trigger, "reset", self._reset)
        self.add_timer(0.1, self._on_timer)

    def apply_runtime_config(self, config: CollectorConfig) -> None:
        """Changes the gates; they hold from the next scan on."""
        self._config = config
        for camera, assembler in zip(self._rig.cameras, self._assembler.assemblers.values()):
            assembler.apply_gates(replace(
                camera.config, min_motion_m=config.min_motion_m,
                min_motion_rad=config.min_motion_rad, min_change=config.min_change,
                min_sharpness=config.min_sharpness))

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile) -> Subscription:
        """Subscribes as every node does; what comes from cameras and TF is recorded besides."""
        return super().subscribe(
            kind, topic, self._recording.record_before(kind, topic, callback), qos
        )

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Takes data from now on; a scan that starts by itself does."""
        result = super().on_activate(state)
        self._carry_out(self._session.start_by_itself())
        return result

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ends the recording; the scan so far is kept."""
        self._recording.stop("deactivated")
        return super().on_deactivate(state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Ends the recording and releases all that `setup` made."""
        self._recording.stop("shutdown")
        return super().on_shutdown(state)

    def destroy_node(self) -> None:
        """Finishes the recording, then destroys the node."""
        self._recording.close()
        super().destroy_node()

    def _carry_out(self, events: Iterable[scan_events.ScanEvent]) -> None:
        """Does what the session asks for, in order."""
        for event in events:
            match event:
                case scan_events.ScanOpened(scan):
                    self._recording.start(scan)
                    if self._config.mode != "cycle":
                        self.get_logger().info(opened_line(scan))
                case scan_events.ScanClosed(scan):
                    self._recording.stop("stop_scan")
                    if self._config.mode == "cycle":  # only now it is a scan with an id
                        self.get_logger().info(opened_line(scan))
                case scan_events.ViewReady(scan, camera, view):
                    self._posed_images.publish(to_posed_image(
                        view, self._config.world_frame, scan.scan_id, scan.part, camera))
                case scan_events.ViewDropped(view):
                    self._recording.note_overrun(view)
                case scan_events.ScanSent(scan):
                    self._publish_status(ScanStatus.STOPPED, scan)
                case scan_events.ViewsDecided(scan):
                    self._publish_status(ScanStatus.SCANNING, scan)
                case scan_events.Problem(text, repeated=True):
                    self.get_logger().warning(text, throttle_duration_sec=5.0)
                case scan_events.Problem(text):
                    self.get_logger().error(text)

    def _publish_status(self, state: int, scan: QueuedScan | None) -> None:
        tally = scan.tally if scan is not None and scan.closed else self._session.tally
        skipped = Counter(tally.skipped) + (scan.lost if scan is not None else Counter())
        self._status.publish(ScanStatus(
            header=to_header(self.get_clock().now().nanoseconds, self._config.world_frame),
            node="collector", scan_id=scan.scan_id if scan else "", state=state,
            **to_part_fields(scan.part if scan else PartRequest()),
            problems=self._topics.problems() if scan and not scan.views else [],
            received=tally.received, processed=scan.views if scan else 0,
            skip_reasons=list(skipped), skip_counts=list(skipped.values()),
            missing_cameras=list(scan.missing) if scan else []))

    def _on_status(self, message: ScanStatus) -> None:
        if message.node == "reconstructor":
            self._carry_out(self._session.on_reconstructor_status(
                message.scan_id, message.received, is_idle=message.state == ScanStatus.IDLE,
                is_stopped=message.state == ScanStatus.STOPPED))

    def _on_timer(self) -> None:
        self._topics.follow_publishers()
        self._session.reconstructor_ready &= self._posed_images.get_subscription_count() > 0
        self._carry_out(self._session.on_timer(self._topics.message_since_tick))
        self._topics.message_since_tick = False

    def _start_scan(self, request: StartScan.Request, response: StartScan.Response
                    ) -> StartScan.Response:
        if not self.active:
            response.message = "the collector is not active; expected an active node"
            return response
        try:
            check_names(scan_id=request.scan_id, part=request.part)
            self._session.check_startable()
            self._part.request(from_part_fields(request))
        except (ScanError, PartError, ConfigError) as error:
            response.message = str(error)
            response.scan_id = self._session.open_scan_id if isinstance(error, ScanError) else ""
            return response
        self._carry_out(self._session.start(request.scan_id))
        response.accepted, response.scan_id = True, self._session.open_scan_id
        if lines := self._topics.problems():
            response.message = "; ".join(lines)
            self.get_logger().warning(response.message)
        response.unmatched_topics = self._topics.unmatched
        return response

    async def _stop_scan(self, request: StopScan.Request, response: StopScan.Response
                         ) -> StopScan.Response:
        await self._topics.handle_waiting_messages()
        try:
            self._carry_out(self._session.stop())
        except ScanError as error:
            response.message = str(error)
            return response
        if (scan := self._session.last_closed) is not None:
            response.accepted, response.scan_id = True, scan.scan_id
            response.published = scan.views
            response.message = "" if scan.views else "; ".join(self._topics.problems())
        return response

    def _reset(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        if lost := forgotten_line(self._session.queue):
            self.get_logger().warning(lost)
        self._session = make_session(self._config.mode, self._rig, self._assembler,
                                     self._part.look_up)
        self._recording.stop("reset")
        self._publish_status(ScanStatus.IDLE, None)
        if self.active:
            self._carry_out(self._session.start_by_itself())
        response.success = True
        return response

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Names silent cameras and TF, and views and scans that wait."""
        lines = [(WARN, line) for line in self._topics.problems()]
        lines += self._topics.silence_warnings() if self._session.accepting_images else []
        return lines + [(WARN, line) for line in self._session.problems()]

    def status_values(self) -> Mapping[str, object]:
        """Returns rates, latencies, queues and skip reasons."""
        return {"mode": self._config.mode, **self._topics.status_values(),
                **self._session.status_values()}


def main() -> None:
    """Runs the node."""
    run(Collector)


if __name__ == "__main__":
    main()
