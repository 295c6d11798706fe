# SPDX-License-Identifier: Apache-2.0
"""Runs many tasks at once: in processes of this machine, or on a Ray cluster.

Each worker has one task at a time. When a worker is lost it is known which task it had: that one
begins again on a new worker, and no other.
"""

from __future__ import annotations

import argparse
import logging
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack
from dataclasses import dataclass
from typing import Any, Generic, Protocol, TypeVar

from stack_counter.errors import LostWorkerError
from stack_counter.tasks.child_processes import worker_pool
from stack_counter.tasks.ray_actors import RayCrew, use_one_thread

T = TypeVar("T")
R = TypeVar("R")

_LOG = logging.getLogger(__name__)
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

    @staticmethod
    def add_arguments(command: argparse.ArgumentParser) -> None:
        """Adds `--workers N` and `--ray ADDRESS` to a command."""
        where = command.add_mutually_exclusive_group()
        where.add_argument("--workers", type=_positive, default=1, metavar="N",
                           help="processes of this machine (default 1)")
        where.add_argument("--ray", default="", metavar="ADDRESS",
                           help="all CPUs of a Ray cluster; local: one that is started here")

    @classmethod
    def of(cls, options: argparse.Namespace) -> Workers:
        """Returns where the command line has tasks run."""
        return cls(options.workers, options.ray)


def _positive(text: str) -> int:
    """Argument type: a whole number above 0."""
    if not text.isdecimal() or int(text) == 0:
        raise argparse.ArgumentTypeError(f"'{text}'; expected a whole number above 0")
    return int(text)


def map_tasks(function: Callable[[T], R], tasks: Iterable[T], workers: Workers) -> Iterator[R]:
    """Yields what the function gives for every task, in the order of the tasks.

    One process alone is this one: nothing is started, nor sent.

    Raises:
        ConfigError: the Ray cluster cannot be reached, or Ray is not installed.
        LostWorkerError: a task has lost one worker after the other.
    """
    if workers == Workers():
        yield from map(function, tasks)
        return
    done: dict[int, R] = {}
    following = 0
    for (index, _), future in run_tasks(_OfNumbered(function), list(enumerate(tasks)), workers):
        done[index] = future.result()
        while following in done:
            yield done.pop(following)
            following += 1


@dataclass(frozen=True)
class _OfNumbered(Generic[T, R]):
    """A function of tasks, as one of tasks with their numbers."""

    function: Callable[[T], R]

    def __call__(self, task: tuple[int, T]) -> R:
        return self.function(task[1])


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
    if not waiting:
        return  # nothing is started
    with ExitStack() as stack:
        crew: _Crew = RayCrew(function, workers.ray, stack) if workers.ray \
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
                    _LOG.error("a worker was killed; its task begins again")
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

    lost: tuple[type[BaseException], ...] = (BrokenProcessPool,)

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
    use_one_thread()
    _kept[:] = [function]


def _call_kept(task: Any) -> Any:
    return _kept[0](task)
