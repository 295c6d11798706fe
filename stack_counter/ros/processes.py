"""Starts the three nodes as processes on a ROS domain of their own, and stops them cleanly."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import tempfile
from pathlib import Path
from types import TracebackType

from stack_counter.config import Config, to_ros_parameters
from stack_counter.errors import StackCounterError
from stack_counter.files import config_path

NODES = ("collector", "reconstructor", "counter")
_STOP_WITHIN_S = 5.0


class NodeError(StackCounterError):
    """A node did not start, or died."""


def private_environment() -> dict[str, str]:
    """Environment variables of a ROS domain that no one else on this machine is likely to use.

    The Fast DDS profile gives images a shared memory segment that holds them.
    """
    return {"ROS_DOMAIN_ID": str(random.SystemRandom().randrange(1, 101)),
            "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
            "FASTRTPS_DEFAULT_PROFILES_FILE": os.environ.get(
                "FASTRTPS_DEFAULT_PROFILES_FILE", str(config_path("fastdds.xml")))}


class NodeProcesses:
    """Context manager around the three node processes."""

    def __init__(self, config: Config, environment: dict[str, str]):
        """Nothing starts before `__enter__`; `environment` is added to this process's own."""
        self._config = config
        self._environment = {**os.environ, **environment}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._folder = tempfile.TemporaryDirectory(prefix="stack_counter_")

    def __enter__(self) -> NodeProcesses:
        folder = Path(self._folder.name)
        parameters = folder / "parameters.yaml"
        parameters.write_text(to_ros_parameters(self._config))
        for name in NODES:
            with open(folder / f"{name}.log", "wb") as log:
                self._processes[name] = subprocess.Popen(
                    [sys.executable, "-m", f"stack_counter.nodes.{name}", "--ros-args",
                     "--params-file", str(parameters)],
                    env=self._environment, stdout=log, stderr=subprocess.STDOUT,
                    start_new_session=True)  # a Ctrl-C of the terminal is for us to pass on
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None,
                 trace: TracebackType | None) -> None:
        for process in self._processes.values():
            if process.poll() is None:
                process.send_signal(signal.SIGINT)
        for process in self._processes.values():
            try:
                process.wait(_STOP_WITHIN_S)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
        self._folder.cleanup()

    def check(self) -> None:
        """Raises NodeError with its last words if a node has ended."""
        for name, process in self._processes.items():
            if process.poll() is not None:
                raise NodeError(f"node {name} ended with {process.returncode}; the nodes said: "
                                f"{self.last_words()}")

    def last_words(self) -> str:
        """The last line that each node has printed."""
        words = []
        for name in self._processes:
            log = (Path(self._folder.name) / f"{name}.log").read_text(errors="replace")
            words += [f"{name}: {line}" for line in log.strip().splitlines()[-1:]]
        return "; ".join(words) or "nothing"
