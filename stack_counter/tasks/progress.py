# SPDX-License-Identifier: Apache-2.0
"""How far long work is: a bar where stderr is a terminal, elsewhere a line now and then."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sized
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TypeVar

from tqdm import tqdm

T = TypeVar("T")


@dataclass(frozen=True)
class ProgressSettings:
    """How progress is told; all are chosen.

    Attributes:
        line_period_s: seconds between two lines where stderr is no terminal.
        smoothing: weight of the last step in the speed that a bar shows: steps that several
            processes finish come in bursts.
    """

    line_period_s: float = 30.0
    smoothing: float = 0.05


SETTINGS = ProgressSettings()


def progress(items: Iterable[T], label: str, unit: str, total: int | None = None) -> Iterator[T]:
    """Yields the items and tells how many have been dealt with.

    Args:
        items: each is dealt with when the next one is asked for.
        label: what is done.
        unit: what the items are, in the plural.
        total: number of items; None: their length, if they have one.
    """
    total = len(items) if total is None and isinstance(items, Sized) else total
    with progress_bar(label, unit, total) as advance:
        for item in items:
            yield item
            advance()


@contextmanager
def progress_bar(label: str, unit: str, total: int | None = None, done: int = 0
                 ) -> Iterator[Callable[..., None]]:
    """Tells how far work is; gives what is to be called after each step, or after `n` of them.

    Args:
        label: what is done.
        unit: what is counted, in the plural.
        total: number of steps; None: not known.
        done: number of steps that were done before.
    """
    bar = tqdm(total=total, initial=done, unit=f" {unit}", desc=label,
               smoothing=SETTINGS.smoothing) if sys.stderr.isatty() \
        else _Lines(label, unit, total, done)
    with bar:

        def advance(n: int = 1) -> None:
            bar.update(n)
        yield advance


def write_line(text: str) -> None:
    """Prints a line to stdout, above the bar if there is one."""
    tqdm.write(text)


class _Lines:
    """Stands in for a bar where there is no terminal: prints a line to stderr now and then."""

    def __init__(self, label: str, unit: str, total: int | None, done: int):
        self._label, self._unit, self._total = label, unit, total
        self._before = self._done = done
        self._begin = time.monotonic()
        self._ended = threading.Event()

    def __enter__(self) -> _Lines:
        threading.Thread(target=self._print_lines, daemon=True).start()
        return self

    def __exit__(self, *error: object) -> None:
        self._ended.set()

    def update(self, n: int = 1) -> None:
        self._done += n

    def _print_lines(self) -> None:
        while not self._ended.wait(SETTINGS.line_period_s):
            print(self._line(), file=sys.stderr, flush=True)

    def _line(self) -> str:
        seconds = time.monotonic() - self._begin
        of_total = f" of {self._total}" if self._total else ""
        line = f"{self._label}: {self._done}{of_total} {self._unit}, " \
               f"{tqdm.format_interval(seconds)} so far"
        if self._total and self._done > self._before:
            left = seconds * (self._total - self._done) / (self._done - self._before)
            line += f", about {tqdm.format_interval(left)} to go"
        return line
