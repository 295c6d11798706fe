"""Starts the three nodes and keeps them running: `stack-counter run`, where launch is not there.

A node that dies is started again; a scan that it had is reported as lost, on the topic that its
count would have come on.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from stack_counter_msgs.msg import ScanStatus, StackCount
from std_msgs.msg import Header
from std_srvs.srv import Trigger

from stack_counter.config import NAMESPACE
from stack_counter.files import config_path
from stack_counter.ros.diagnostics import ERROR, OK, to_array
from stack_counter.ros.qos import DIAGNOSTICS, LATCHED, RELIABLE

NODES = ("collector", "reconstructor", "counter")
_STOP_WITHIN_S = 5.0
_CALM_S = 30.0  # after so long a death is no longer one of a row
_LONGEST_PAUSE_S = 30.0
_SAID_S = 10.0  # that a death stays an ERROR in the diagnostics


@dataclass
class Child:
    """One node's process, how often it was started again, and when that may be (s, monotonic)."""

    name: str
    process: subprocess.Popen[str] | None = None
    restarts: int = 0
    in_a_row: int = 0
    started_at: float = 0.0
    due_at: float = 0.0
    copied: threading.Thread | None = field(default=None, repr=False)

    def start(self, parameters: Path) -> None:
        """Starts it; what it prints goes to our output, behind its name."""
        self.process = subprocess.Popen(
            [sys.executable, "-m", f"stack_counter.nodes.{self.name}", "--ros-args",
             "--params-file", str(parameters)],
            env={**os.environ, "FASTRTPS_DEFAULT_PROFILES_FILE": os.environ.get(
                "FASTRTPS_DEFAULT_PROFILES_FILE", str(config_path("fastdds.xml")))},
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
            start_new_session=True)  # a Ctrl-C of the terminal is for us to pass on
        self.started_at, self.due_at = time.monotonic(), 0.0
        self.copied = threading.Thread(target=self._copy, args=(self.process,), daemon=True)
        self.copied.start()

    def _copy(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None  # for the type checker
        for line in process.stdout:
            print(f"{self.name}: {line}", end="", flush=True)

    def died(self) -> str:
        """How it ended, if it has just done so; it is then due to start again, later each time."""
        if self.process is None or self.process.poll() is None:
            return ""
        code, self.process = self.process.returncode, None
        now = time.monotonic()
        self.in_a_row = 0 if now - self.started_at > _CALM_S else self.in_a_row + 1
        self.restarts += 1
        self.due_at = now + min(2.0**self.in_a_row - 1, _LONGEST_PAUSE_S)
        return f"signal {-code}" if code < 0 else f"exit code {code}"


class Supervisor(Node):
    """Watches the processes, and the scans that they have."""

    def __init__(self, parameters: Path):
        super().__init__("supervisor", namespace=NAMESPACE)
        self._parameters = parameters
        self.children = {name: Child(name) for name in NODES}
        self._open = ""  # the scan whose final count has not come
        self._closed = ""  # the one before
        self._last_death, self._died_at = "", -_SAID_S
        self._count = self.create_publisher(StackCount, "count", LATCHED)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics",
                                                  DIAGNOSTICS)
        self.create_subscription(ScanStatus, "scan_status", self._on_status, RELIABLE)
        self.create_subscription(StackCount, "count", self._on_count, LATCHED)
        self._resets = [self.create_client(Trigger, name)
                        for name in ("reset", "reset_reconstruction")]
        for child in self.children.values():
            child.start(parameters)
        self.create_timer(0.2, self._watch)
        self.create_timer(1.0, self._diagnose)

    def _on_status(self, message: ScanStatus) -> None:
        if message.state == ScanStatus.IDLE:
            if message.node == "collector":
                self._close()
        elif message.node == "collector" or message.scan_id != self._closed:
            # The collector says it once, perhaps too early; the reconstructor says it often.
            self._open = message.scan_id

    def _on_count(self, message: StackCount) -> None:
        if message.final and message.scan_id == self._open:
            self._close()

    def _close(self) -> None:
        self._closed, self._open = self._open or self._closed, ""

    def _watch(self) -> None:
        for child in self.children.values():
            how = child.died()
            if how:
                self._report(child, how)
            if child.due_at and time.monotonic() >= child.due_at:
                child.start(self._parameters)

    def _report(self, child: Child, how: str) -> None:
        self._last_death = f"{child.name} ended with {how}"
        self._died_at = time.monotonic()
        wait = child.due_at - time.monotonic()
        self.get_logger().error(f"{self._last_death}; it starts again in {max(wait, 0):.0f} s")
        if self._open:
            error = f"scan '{self._open}' lost: {self._last_death}"
            self.get_logger().error(error)
            self._count.publish(StackCount(
                header=Header(stamp=self.get_clock().now().to_msg()), scan_id=self._open,
                final=True, status=StackCount.STATUS_ERROR, error=error))
            self._close()
        for client in self._resets:  # what the others hold of that scan is of no use
            if client.service_is_ready():
                client.call_async(Trigger.Request())

    def _diagnose(self) -> None:
        recent = time.monotonic() - self._died_at < _SAID_S
        values = {f"{c.name} {key}": value for c in self.children.values()
                  for key, value in (("restarts", c.restarts),
                                     ("running", c.process is not None))}
        self._diagnostics.publish(to_array(
            "supervisor", ERROR if recent else OK, self._last_death if recent else "ok", values,
            Header(stamp=self.get_clock().now().to_msg())))

    def stop(self) -> None:
        """Ends the processes: asks, then kills."""
        running = [c.process for c in self.children.values() if c.process is not None]
        for process in running:
            process.send_signal(signal.SIGINT)
        deadline = time.monotonic() + _STOP_WITHIN_S
        for process in running:
            try:
                process.wait(max(deadline - time.monotonic(), 0.1))
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()


def supervise(parameters: Path) -> int:
    """Runs until SIGINT or SIGTERM; `parameters`: a ROS parameter file for all three nodes."""
    rclpy.init()
    node = Supervisor(parameters)
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
