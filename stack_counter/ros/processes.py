# SPDX-License-Identifier: Apache-2.0
"""The three nodes as processes: started together for one replay, or kept running."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import IO

from stack_counter.config import Config, to_ros_parameters
from stack_counter.errors import StackCounterError
from stack_counter.files import config_path
from stack_counter.ros.security import enclave_arguments
from stack_counter.tasks.child_processes import ENDS_WITH_STDIN

NODES = ("collector", "reconstructor", "counter")


@dataclass(frozen=True)
class ProcessSettings:
    """When processes are ended by force and started again.

    Attributes:
        stop_timeout_s: seconds from SIGTERM to SIGKILL. Measured by `make soak`: nodes end within
            1.4 s.
        stable_after_s: seconds of running after which a death counts as the first of a row again.
            Chosen.
        max_restart_pause_s: longest pause before a start, s; it doubles with each death of a row.
            Chosen.
    """

    stop_timeout_s: float = 5.0
    stable_after_s: float = 30.0
    max_restart_pause_s: float = 30.0


SETTINGS = ProcessSettings()


class NodeError(StackCounterError):
    """A node did not start, or died."""


def shared_memory_environment() -> dict[str, str]:
    """Returns the variable of a Fast DDS profile whose shared memory segment holds images.

    A profile that is set already stays.
    """
    name = "FASTRTPS_DEFAULT_PROFILES_FILE"
    return {name: os.environ.get(name, str(config_path("fastdds.xml")))}


def _start_node(name: str, parameters: Path, environment: Mapping[str, str], output: IO | int,
                ros_arguments: Sequence[str] = ()) -> subprocess.Popen[str]:
    """Starts one node as a process, which ends with this one, whatever ends this.

    Args:
        name: one of `NODES`.
        parameters: ROS parameter file.
        environment: added to that of this process.
        output: where the node's stdout and stderr go, as for `subprocess.Popen`.
        ros_arguments: further ones, as remappings: -r FROM:=TO.
    """
    return subprocess.Popen(
        [sys.executable, "-m", "stack_counter.nodes", name, "--ros-args", "--params-file",
         str(parameters), *ros_arguments],
        env={**os.environ, **environment, ENDS_WITH_STDIN: "1"}, stdin=subprocess.PIPE,
        stdout=output, stderr=subprocess.STDOUT, text=True, errors="replace",
        start_new_session=True)  # Ctrl-C in the terminal reaches this process, which passes it on


def _stop_processes(processes: Iterable[subprocess.Popen[str]]) -> None:
    """Sends SIGTERM to the processes, and SIGKILL to those that do not end in time.

    Not SIGINT: one that comes while Python itself starts is answered by a traceback.
    """
    running = [process for process in processes if process.poll() is None]
    for process in running:
        process.terminate()
    deadline = time.monotonic() + SETTINGS.stop_timeout_s
    for process in running:
        try:
            process.wait(max(deadline - time.monotonic(), 0.1))
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


class NodeProcesses:
    """Context manager around the three node processes of one replay."""

    def __init__(self, config: Config, environment: Mapping[str, str]):
        """Keeps the settings; nothing starts before `__enter__`.

        Args:
            config: written to a parameter file for all nodes.
            environment: added to that of this process.
        """
        self._config, self._environment = config, environment
        self._processes: dict[str, subprocess.Popen[str]] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="stack_counter_")

    def __enter__(self) -> NodeProcesses:
        """Starts the nodes; what they print goes to files."""
        parameters = Path(self._folder.name) / "parameters.yaml"
        parameters.write_text(to_ros_parameters(self._config))
        for name in NODES:
            with open(self._log_path(name), "wb") as log:
                self._processes[name] = _start_node(name, parameters, self._environment, log)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        """Stops the nodes."""
        _stop_processes(self._processes.values())
        self._folder.cleanup()

    def check(self) -> None:
        """Checks that all nodes run.

        Raises:
            NodeError: a node has ended; the message has the last line that each has printed.
        """
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise NodeError(f"node {name} ended with {process.returncode}; the nodes said: "
                                f"{self.last_lines()}")

    def last_lines(self) -> str:
        """Returns the last line that each node has printed."""
        lines = []
        for name in self._processes:
            log = self._log_path(name).read_text(errors="replace")
            lines += [f"{name}: {line}" for line in log.strip().splitlines()[-1:]]
        return "; ".join(lines) or "nothing"

    def _log_path(self, name: str) -> Path:
        return Path(self._folder.name) / f"{name}.log"


class SupervisedProcess:
    """One node's process that is started again whenever it ends, later each time in a row.

    Attributes:
        name: one of `NODES`.
        restarts: number of times that it ended by itself.
        restart_at: when it may start again, seconds of `time.monotonic`; 0 while it runs.
    """

    def __init__(self, name: str, parameters: Path, ros_arguments: Sequence[str] = ()):
        """Starts the process.

        Args:
            name: one of `NODES`.
            parameters: ROS parameter file.
            ros_arguments: further ones, as remappings: -r FROM:=TO.
        """
        self.name, self.restarts, self.restart_at = name, 0, 0.0
        self._parameters, self._ros_arguments = parameters, ros_arguments
        self._deaths_in_a_row = 0
        self._start()

    def _start(self) -> None:
        """Starts the process; what it prints is printed here, behind its name."""
        process = _start_node(self.name, self._parameters, shared_memory_environment(),
                              subprocess.PIPE,
                              [*enclave_arguments(self.name), *self._ros_arguments])
        self._process: subprocess.Popen[str] | None = process
        self._started_at, self.restart_at = time.monotonic(), 0.0
        threading.Thread(target=self._print_output, args=(process,), daemon=True).start()

    def _print_output(self, process: subprocess.Popen[str]) -> None:
        assert process.stdout is not None  # for the type checker
        for line in process.stdout:
            print(f"{self.name}: {line}", end="", flush=True)

    @property
    def running(self) -> bool:
        """Whether the process runs, as far as `take_death` has noticed."""
        return self._process is not None

    def take_death(self) -> str:
        """Returns how the process ended, once for each time; "" if it has not.

        Its next start is due after a pause that doubles with each death in a row.
        """
        if self._process is None or self._process.poll() is None:
            return ""
        code, self._process = self._process.returncode, None
        now = time.monotonic()
        stable = now - self._started_at > SETTINGS.stable_after_s
        self._deaths_in_a_row = 0 if stable else self._deaths_in_a_row + 1
        self.restarts += 1
        self.restart_at = now + min(2.0**self._deaths_in_a_row - 1, SETTINGS.max_restart_pause_s)
        return f"signal {-code}" if code < 0 else f"exit code {code}"

    def restart_if_due(self) -> None:
        """Starts the process again once its pause is over."""
        if self.restart_at and time.monotonic() >= self.restart_at:
            self._start()

    @staticmethod
    def stop_all(processes: Iterable[SupervisedProcess]) -> None:
        """Ends the processes: by SIGTERM, and by SIGKILL those that do not end in time."""
        _stop_processes([p._process for p in processes if p._process is not None])
