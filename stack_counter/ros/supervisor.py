# SPDX-License-Identifier: Apache-2.0
"""Starts the three nodes and keeps them running: `stack-counter run`, where launch is not there.

A node that dies is started again; a scan that it had is reported as lost, where its count would
have come.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.clock import Clock, ClockType
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from stack_counter_msgs.msg import ScanStatus, StackCount, StackVolume
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from stack_counter.config import load_config
from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.ros.diagnostics import ERROR, OK, to_array
from stack_counter.ros.part_fields import from_part_fields
from stack_counter.ros.processes import NODES, SupervisedProcess
from stack_counter.ros.qos import DIAGNOSTICS, FINAL_TOPICS, LATCHED_ALL, RESULT_JSON
from stack_counter.ros.result_line import to_flat_json
from stack_counter.ros.security import check_security, enclave_arguments
from stack_counter.types import PartRequest


@dataclass(frozen=True)
class SupervisorSettings:
    """Periods of the supervisor; all are chosen.

    Attributes:
        watch_period_s: seconds between two looks at the processes.
        diagnostics_period_s: seconds between two diagnostics.
        error_shown_s: seconds for which a death stays an ERROR in the diagnostics.
    """

    watch_period_s: float = 0.2
    diagnostics_period_s: float = 1.0
    error_shown_s: float = 10.0


SETTINGS = SupervisorSettings()


class Supervisor(Node):
    """Restarts processes that end, and reports the scans that are lost with them."""

    def __init__(self, parameters: Path, ros_arguments: Sequence[str] = ()):
        """Starts the nodes with a ROS parameter file for all three, and further arguments.

        Raises:
            ConfigError: the file holds no such parameters.
        """
        super().__init__("supervisor", namespace=NAMESPACE)
        config = load_config(parameters)
        self._regions = [region.name for region in config.reconstructor.regions] or [""]
        # Part of the scans that name none, and of the open scan.
        own = config.counter
        self._with_json = own.result_json
        self._own_part = PartRequest(own.part, own.unit_volume_m3, own.part_size_m)
        self._part = PartRequest()
        self._counted: set[str] = set()  # regions of the open scan whose final count has come
        self._open_scan = ""  # id of the scan of which a final count has not come
        self._opened_ns = 0  # when the first word of it was published
        self._closed_scan = ""  # id of the scan before
        self._last_death, self._died_ns = "", 0  # and when
        self._nodes_to_reset: set[str] = set()  # names
        self._lost_scan = ""  # id of the scan that was reported as lost last
        self._advertise_losses()
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", DIAGNOSTICS)
        # rclpy gives a callback of two parameters what it knows about the message as well.
        self.create_subscription(ScanStatus, "scan_status",
                                 self._on_status, LATCHED_ALL)  # type: ignore[arg-type]
        self.create_subscription(StackCount, "result", self._on_result, LATCHED_ALL)
        self._resets = {"collector": self.create_client(Trigger, "reset"),
                        "reconstructor": self.create_client(Trigger, "reset_reconstruction")}
        self._processes = [SupervisedProcess(name, parameters, ros_arguments)
                           for name in NODES]
        steady = Clock(clock_type=ClockType.STEADY_TIME)  # also where the nodes' is a bag's
        self.create_timer(SETTINGS.watch_period_s, self._watch_processes, clock=steady)
        self.create_timer(SETTINGS.diagnostics_period_s, self._publish_diagnostics, clock=steady)

    # --- which scan is open -------------------------------------------------------------------

    def _on_status(self, message: ScanStatus, about: dict[str, Any]) -> None:
        if message.state == ScanStatus.IDLE:
            if message.node == "collector":
                self._close_scan()
        elif message.scan_id and (message.scan_id != self._closed_scan or _is_open(message)):
            published_ns = about["source_timestamp"]
            if message.scan_id == self._lost_scan and published_ns < self._died_ns:
                return  # word from before the death that was reported
            if message.scan_id != self._open_scan:
                self._opened_ns = published_ns
            self._open_scan = message.scan_id
            self._part = from_part_fields(message)

    def _on_result(self, message: StackCount) -> None:
        # A counter that starts anew counts old volumes again: those results are no newer ones.
        if message.scan_id != self._lost_scan and message.scan_id in (self._open_scan,
                                                                      self._closed_scan):
            self._withdraw_losses()
        if message.scan_id == self._open_scan:
            self._counted.add(message.region)
            if self._counted >= set(self._regions):
                self._close_scan()

    def _close_scan(self) -> None:
        self._closed_scan, self._open_scan = self._open_scan or self._closed_scan, ""
        self._counted.clear()

    # --- processes ----------------------------------------------------------------------------

    def _watch_processes(self) -> None:
        for process in self._processes:
            cause = process.take_death()
            if cause:
                self._note_death(process, cause)
            process.restart_if_due()
        if self._open_scan and self._opened_ns < self._died_ns:
            self._report_lost(f"scan '{self._open_scan}' lost: {self._last_death}")
            self._close_scan()
        self._reset_nodes()

    def _note_death(self, process: SupervisedProcess, cause: str) -> None:
        """Logs a death; the scan that was open is lost, also where word of it is yet to come."""
        self._last_death = f"{process.name} ended with {cause}"
        self._died_ns = time.time_ns()
        pause_s = max(process.restart_at - time.monotonic(), 0)
        self.get_logger().error(f"{self._last_death}; it starts again in {pause_s:.0f} s")
        self._nodes_to_reset = set(self._resets) - {process.name}

    def _reset_nodes(self) -> None:
        """Has the nodes that a death left forget its scan, once they are found."""
        for name in [n for n in self._nodes_to_reset if self._resets[n].service_is_ready()]:
            self._resets[name].call_async(Trigger.Request())
            self._nodes_to_reset.remove(name)

    # --- scans that are lost ------------------------------------------------------------------

    def _advertise_losses(self) -> None:
        qos = QoSProfile(depth=len(self._regions), durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self._volume = self.create_publisher(StackVolume, "volume", qos)
        self._results = [self.create_publisher(StackCount, topic, qos) for topic in FINAL_TOPICS]
        self._json = [self.create_publisher(String, RESULT_JSON, qos)] if self._with_json else []

    def _report_lost(self, error: str) -> None:
        """Reports the open scan as one without a volume; without a counter, as one without count.

        The counter, if it runs, makes results of it as of every other scan, and ends a request.
        """
        self.get_logger().error(error)
        self._withdraw_losses()
        counting = any(process.name == "counter" and process.running
                       for process in self._processes)
        part = self._part if self._part.names_a_part else self._own_part
        for region in [name for name in self._regions if name not in self._counted]:
            fields = {"header": self._header_now(), "scan_id": self._open_scan, "region": region,
                      "final": True, "error": error, "part": part.name,
                      "unit_volume": part.unit_volume}
            if counting:
                self._volume.publish(StackVolume(**fields, part_size=list(part.outer_size_m)))
            else:
                count = StackCount(status=StackCount.STATUS_ERROR, **fields)
                for publisher in self._results:
                    publisher.publish(count)
                for publisher in self._json:
                    publisher.publish(to_flat_json(count, StackVolume()))
        self._lost_scan = self._open_scan

    def _withdraw_losses(self) -> None:
        """Unlatches what was reported as lost: there is something newer."""
        if self._lost_scan:
            for publisher in (self._volume, *self._results, *self._json):
                self.destroy_publisher(publisher)
            self._lost_scan = ""
            self._advertise_losses()

    # --- what is published --------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        recent = time.time_ns() - self._died_ns < SETTINGS.error_shown_s * 1e9
        values: dict[str, object] = {}
        for process in self._processes:
            values[f"{process.name} restarts"] = process.restarts
            values[f"{process.name} running"] = process.running
        self._diagnostics.publish(to_array(
            "supervisor", ERROR if recent else OK, self._last_death if recent else "ok", values,
            self._header_now()))

    def _header_now(self) -> Header:
        return Header(stamp=self.get_clock().now().to_msg())

    def stop(self) -> None:
        """Ends the processes."""
        SupervisedProcess.stop_all(self._processes)


def supervise(parameters: Path, ros_arguments: Sequence[str] = ()) -> int:
    """Runs the three nodes until SIGINT or SIGTERM; returns the exit code.

    Args:
        parameters: ROS parameter file for all three.
        ros_arguments: further ones of all three and of the supervisor, as -r FROM:=TO.

    Raises:
        ConfigError: security is asked for and cannot be had.
    """
    check_security()
    # The command's own words are not for ROS.
    rclpy.init(args=["supervisor", "--ros-args", *enclave_arguments("supervisor"),
                     *ros_arguments])
    node = Supervisor(parameters, ros_arguments)
    executor = SingleThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        node.stop()
        node.destroy_node()
        rclpy.try_shutdown()
    return 0


def _is_open(message: ScanStatus) -> bool:
    """Returns whether the collector takes images into the scan of this message."""
    return message.node == "collector" and message.state == ScanStatus.SCANNING
