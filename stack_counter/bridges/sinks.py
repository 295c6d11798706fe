# SPDX-License-Identifier: Apache-2.0
"""Sinks of results, in a thread of their own: whoever gives them results never waits for one."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from threading import Thread
from typing import Any, Protocol


class ResultSink(Protocol):
    """What results are brought to; all is called in the thread of its event loop."""

    async def run(self) -> None:
        """Brings results there until it is cancelled.

        Raises:
            ConfigError: it never can, by its settings.
        """

    def put(self, result: Mapping[str, Any]) -> None:
        """Takes a flat result, and returns at once."""

    def set_available(self, available: bool) -> None:
        """Takes whether a counter is there, and returns at once."""


@dataclass(frozen=True)
class SinkThreadSettings:
    """How sinks are ended.

    Attributes:
        goodbye_s: seconds that they have to say goodbye. Chosen.
    """

    goodbye_s: float = 5.0


SETTINGS = SinkThreadSettings()


class SinkThread:
    """Runs sinks in an event loop of their own."""

    def __init__(self, sinks: Sequence[ResultSink]):
        """Starts the thread."""
        self._sinks = sinks
        self._loop = asyncio.new_event_loop()
        self._thread = Thread(target=self._loop.run_forever, name="sinks", daemon=True)
        self._thread.start()
        self._task = asyncio.run_coroutine_threadsafe(self._start(), self._loop).result()

    async def _start(self) -> asyncio.Task[None]:
        return asyncio.create_task(self._run())

    async def _run(self) -> None:
        """Runs all sinks until one cannot, or the task is cancelled."""
        tasks = [asyncio.create_task(sink.run()) for sink in self._sinks]
        try:
            await asyncio.gather(*tasks)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

    def put(self, result: Mapping[str, Any]) -> None:
        """Gives every sink a flat result."""
        for sink in self._sinks:
            self._loop.call_soon_threadsafe(sink.put, result)

    def set_available(self, available: bool) -> None:
        """Tells every sink whether a counter is there."""
        for sink in self._sinks:
            self._loop.call_soon_threadsafe(sink.set_available, available)

    def check(self) -> None:
        """Returns if all sinks run.

        Raises:
            ConfigError: one cannot, by its settings.
        """
        if self._task.done():
            self._task.result()

    def close(self) -> None:
        """Ends the sinks and the thread."""
        asyncio.run_coroutine_threadsafe(self._stop(), self._loop).result()
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join()
        self._loop.close()

    async def _stop(self) -> None:
        self._task.cancel()
        await asyncio.wait([self._task], timeout=SETTINGS.goodbye_s)
