# SPDX-License-Identifier: Apache-2.0
"""Runs many tasks at once: in processes of this machine, or on a Ray cluster.

Each worker has one task at a time. When a worker is lost it is known which task it had: that one
begins again on a new worker, and no other.
"""

from __future__ import annotations

import importlib
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Protocol, TypeVar

from stack_counter.child_processes import worker_pool
from stack_counter.errors import ConfigError, LostWorkerError

T = TypeVar("T")
R = TypeVar("R")

LOCAL = "local"  # address that means a Ray of this run's own, on this machine
_THREADS = "OMP_NUM_THREADS"  # by which NumPy, Open3D and ONNX Runtime choose theirs


@dataclass(frozen=True)
class TaskSettings:
    """When a task is given up.

    Attributes:
        max_attempts: workers that a task may lose; chosen: one may be killed by chance, three in
            a row by the task, as for want of memory.
    """

    max_attempts: int = 3


SETTINGS = TaskSettings()


@dataclass(frozen=True)
class Workers:
    """Where tasks run.

    Attributes:
        processes: number of processes of this machine.
        ray: address of a Ray cluster, all of whose CPUs are used instead; `local` starts one on
            this machine; empty: none.
    """

    processes: int = 1
    ray: str = ""


def run_tasks(function: Callable[[T], R], tasks: Iterable[T], workers: Workers
              ) -> Iterator[tuple[T, Future[R]]]:
    """Calls the function with every task, and gives each as soon as it is done.

    Args:
        function: is sent to each worker once, and kept there: what it has loaded for one task, it
            has for the next. Every worker uses one thread, unless OMP_NUM_THREADS says otherwise.
        tasks: in the order in which they begin.
        workers: where.

    Yields:
        A task with its `Future`, which is done: its `result()` raises what the function raised, or
        LostWorkerError where the task has lost one worker after the other.

    Raises:
        ConfigError: the Ray cluster cannot be reached, or Ray is not installed.
    """
    waiting = deque((task, 1) for task in tasks)
    running: dict[Future, tuple[_Worker, T, int]] = {}
    free: list[_Worker] = []
    with ExitStack() as stack:
        crew: _Crew = _RayCrew(function, workers.ray, stack) if workers.ray \
            else _ProcessCrew(function, workers.processes, stack)
        while waiting or running:
            # Give every worker a task; those without one make room for others that must begin.
            while waiting and len(running) < crew.size:
                task, attempt = waiting.popleft()
                worker = free.pop() if free else crew.hire()
                running[worker.submit(task)] = worker, task, attempt
            while free:
                free.pop().dismiss()
            # Take what is done, and begin again what has lost its worker.
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                worker, task, attempt = running.pop(future)
                if not isinstance(future.exception(), crew.lost):
                    free.append(worker)
                    yield task, future
                    continue
                worker.dismiss()
                if attempt < SETTINGS.max_attempts:
                    waiting.append((task, attempt + 1))
                else:
                    yield task, _failed(LostWorkerError(
                        f"its worker was lost {attempt} times, the last time by "
                        f"{type(future.exception()).__name__}; expected one that ends: it was "
                        "killed, or the machine is out of memory"))


def _failed(error: Exception) -> Future:
    future: Future = Future()
    future.set_exception(error)
    return future


class _Worker(Protocol):
    """Does one task at a time."""

    def submit(self, task: Any) -> Future:
        """Begins a task."""

    def dismiss(self) -> None:
        """Frees what the worker, who has no task, holds."""


class _Crew(Protocol):
    """Workers of one kind.

    Attributes:
        size: number of workers at a time.
        lost: errors of a task whose worker is gone.
    """

    size: int
    lost: tuple[type[BaseException], ...]

    def hire(self) -> _Worker:
        """Makes a worker."""


class _ProcessCrew:
    """Each worker is a process of this machine that ends with this one."""

    lost = (BrokenProcessPool,)

    def __init__(self, function: Callable, processes: int, stack: ExitStack):
        self.size = processes
        self._function, self._stack = function, stack

    def hire(self) -> _Worker:
        return _Process(self._function, self._stack)


class _Process:
    """A pool of one process, which keeps the function."""

    def __init__(self, function: Callable, stack: ExitStack):
        self._pool = stack.enter_context(worker_pool(1))
        # The process starts with the first call, and reads its number of threads as it does.
        before = os.environ.get(_THREADS)
        os.environ.setdefault(_THREADS, "1")
        try:
            self._pool.submit(_keep, function)
        finally:
            if before is None:
                del os.environ[_THREADS]

    def submit(self, task: Any) -> Future:
        try:
            return self._pool.submit(_call_kept, task)
        except BrokenProcessPool as error:  # it was lost while it had nothing to do
            return _failed(error)

    def dismiss(self) -> None:
        self._pool.shutdown(wait=False)


_kept: list[Callable] = []  # the function, in a worker's process


def _keep(function: Callable) -> None:
    """Keeps the function in the process of a worker."""
    _use_one_thread()
    _kept[:] = [function]


def _call_kept(task: Any) -> Any:
    return _kept[0](task)


class _RayCrew:
    """Each worker is an actor that has one CPU of a cluster."""

    def __init__(self, function: Callable, address: str, stack: ExitStack):
        ray = _require_ray()
        os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")  # nothing is sent to anybody
        own = {"include_dashboard": False} if address == LOCAL else {}
        try:
            ray.init(address=address, log_to_driver=False, logging_level="ERROR", **own)
        except (ConnectionError, RuntimeError, ValueError) as error:
            raise ConfigError(f"no Ray cluster at '{address}': {' '.join(str(error).split())}; "
                              "expected the address of one, HOST:6379, or 'local'") from error
        stack.callback(ray.shutdown)
        self.size = max(int(ray.cluster_resources().get("CPU", 1)), 1)
        self.lost = (ray.exceptions.RayActorError,)
        self._actor = ray.remote(num_cpus=1, max_restarts=0)(_Actor)
        self._function = ray.put(function)

    def hire(self) -> _Worker:
        return _RayWorker(self._actor.remote(self._function))


class _Actor:
    """Keeps the function on a machine of the cluster."""

    def __init__(self, function: Callable):
        _use_one_thread()
        self._function = function

    def call(self, task: Any) -> Any:
        return self._function(task)


def _use_one_thread() -> None:
    """Has OpenCV, which reads no variable of the environment, use one thread in this process."""
    import cv2  # which no command's help waits for

    cv2.setNumThreads(1)


class _RayWorker:
    """An actor, by its handle."""

    def __init__(self, actor: Any):
        self._actor = actor

    def submit(self, task: Any) -> Future:
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
        _require_ray().kill(self._actor)


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
