# SPDX-License-Identifier: Apache-2.0
"""Workers of a Ray cluster: one actor for each of its CPUs."""

from __future__ import annotations

import importlib
import os
import socket
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any

from stack_counter.errors import ConfigError

LOCAL = "local"  # address that means a Ray of this run's own, on this machine


@dataclass(frozen=True)
class RaySettings:
    """How a cluster is joined.

    Attributes:
        connect_s: seconds within which its head answers; chosen.
    """

    connect_s: float = 10.0


SETTINGS = RaySettings()


class RayCrew:
    """Workers that are actors, each with one CPU of a cluster.

    Attributes:
        size: number of CPUs of the cluster.
        lost: errors of a task whose actor, or its machine, is gone.
    """

    def __init__(self, function: Callable, address: str, stack: ExitStack):
        """Joins a cluster; nothing runs on it yet.

        Args:
            function: what the actors call; sent to each once.
            address: HOST:PORT of its head, `auto`, or `local`.
            stack: leaves the cluster when it is closed.

        Raises:
            ConfigError: the cluster cannot be reached, or Ray is not installed.
        """
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to anybody
        own = {"include_dashboard": False} if address == LOCAL else {}
        try:
            _require_server(address)
            ray = _require_ray()
            ray.init(address=address, log_to_driver=False, logging_level="ERROR", **own)
        except ConfigError:
            raise
        except Exception as error:  # Ray's are of many classes, and some of none
            raise ConfigError(f"no Ray cluster at '{address}': {' '.join(str(error).split())}; "
                              "expected the address of one, HOST:6379, or 'local'") from error
        stack.callback(ray.shutdown)
        self.size = max(int(ray.cluster_resources().get("CPU", 1)), 1)
        self.lost: tuple[type[BaseException], ...] = (ray.exceptions.RayActorError,)
        self._actor = ray.remote(num_cpus=1, max_restarts=0)(_Actor)
        self._function = ray.put(function)
        self._first: Any = self._actor.remote(self._function)
        try:
            ray.get(self._first.call.remote())
        except ray.exceptions.RayActorError as error:
            raise ConfigError(f"a worker of the cluster cannot begin: {_last_line(error)}; "
                              "expected the same packages on every machine") from error

    def hire(self) -> RayWorker:
        """Makes an actor, which begins as soon as a CPU is free."""
        first, self._first = self._first, None
        return RayWorker(first or self._actor.remote(self._function))


class _Actor:
    """Keeps the function on a machine of the cluster."""

    def __init__(self, function: Callable):
        use_one_thread()
        self._function = function

    def call(self, *task: Any) -> Any:
        """Does a task; without one it only says that the actor is there."""
        return self._function(*task) if task else None


def use_one_thread() -> None:
    """Has OpenCV, which reads no variable of the environment, use one thread in this process."""
    import cv2  # which no command's help waits for

    cv2.setNumThreads(1)


class RayWorker:
    """An actor, by its handle."""

    def __init__(self, actor: Any):
        """Takes the handle."""
        self._actor = actor

    def submit(self, task: Any) -> Future:
        """Begins a task."""
        future: Future = Future()

        def hand_on(done: Future) -> None:
            error = done.exception()
            if error is None:
                future.set_result(done.result())
            else:  # an error of the function comes within one of Ray's
                future.set_exception(getattr(error, "cause", None) or error)

        self._actor.call.remote(task).future().add_done_callback(hand_on)
        return future

    def dismiss(self) -> None:
        """Frees the actor's CPU."""
        _require_ray().kill(self._actor)


def _require_server(address: str) -> None:
    """Raises OSError where nobody answers at HOST:PORT, which Ray finds out after minutes."""
    host, _, port = address.rpartition(":")
    if port.isdecimal() and "/" not in host:
        socket.create_connection((host, int(port)), SETTINGS.connect_s).close()


def _last_line(error: Exception) -> str:
    """The line of Ray's message that names the cause."""
    return [line.strip() for line in str(error).splitlines() if line.strip()][-1]


def _require_ray() -> Any:
    """Returns the module `ray`.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module("ray")
    except ModuleNotFoundError as error:
        if error.name != "ray":
            raise
        raise ConfigError("--ray takes the package ray, which is not installed; expected pip "
                          "install 'stack_counter[archive]'") from error
