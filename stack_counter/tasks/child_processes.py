# SPDX-License-Identifier: Apache-2.0
"""Processes that end when the one that started them has ended, in whatever way.

A child waits in a thread for the end of a pipe that only its parent holds open: that works after
SIGKILL as well, on every system, and whichever thread of the parent has started it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

ENDS_WITH_STDIN = "STACK_COUNTER_ENDS_WITH_STDIN"  # environment variable; set for a child


@dataclass(frozen=True)
class ChildProcessSettings:
    """How a child ends.

    Attributes:
        grace_s: seconds from SIGTERM to SIGKILL. `make soak` has nodes end within 1.4 s; chosen
            so long that one in the midst of a view can close its recording.
    """

    grace_s: float = 10.0


SETTINGS = ChildProcessSettings()


def end_with_parent() -> None:
    """Has this process end with its parent, if that has asked for it or is multiprocessing's."""
    parent = multiprocessing.parent_process()
    if parent is not None:
        _end_after(parent.join)
    elif os.environ.get(ENDS_WITH_STDIN):
        _end_after(_read_stdin)


def _read_stdin() -> None:
    """Returns when nobody can write to stdin any more."""
    while os.read(0, 1024):
        pass


def _end_after(wait: Callable[[], object]) -> None:
    """Ends this process once `wait` has returned: by SIGTERM, or else by SIGKILL."""
    def watch() -> None:
        wait()
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(SETTINGS.grace_s)
        os.kill(os.getpid(), signal.SIGKILL)
    threading.Thread(target=watch, daemon=True).start()


@contextmanager
def _interrupts_held_back() -> Iterator[None]:
    """Has SIGINT and SIGTERM come after the block, in the main thread, which gets them.

    Those that are not handled here, as they are ignored, stay as they are: a child inherits that.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    came: list[int] = []
    before = {number: signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)
              if callable(signal.getsignal(number))}
    for number in before:
        signal.signal(number, lambda number, _: came.append(number))
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
        for received in came:
            signal.raise_signal(received)


class _Pool(ProcessPoolExecutor):
    """A pool each of whose processes is started wholly or not at all.

    A task may start one: where an interrupt cuts that off, the new process reads half of what
    it needs, and prints where it failed.
    """

    def submit(self, *arguments: Any, **options: Any) -> Future:
        with _interrupts_held_back():
            return super().submit(*arguments, **options)


@contextmanager
def worker_pool(workers: int) -> Iterator[ProcessPoolExecutor]:
    """Makes a pool of processes that end with this one; an error in the block ends them at once.

    They are spawned: forked ones would inherit the threads of whatever was loaded before.
    """
    with _Pool(workers, mp_context=multiprocessing.get_context("spawn"),
               initializer=end_with_parent) as pool:
        try:
            yield pool
        except BaseException:
            pool.shutdown(wait=False, cancel_futures=True)
            for process in multiprocessing.active_children():
                process.terminate()
            raise
