"""Writes every scan to a file, in a thread of its own, within a bounded part of the disk.

Who scans hands messages over and never waits: a disk that is slow, full or gone ends the
recording, not the scan.
"""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from functools import partial
from pathlib import Path

from stack_counter.bag.record_names import finished
from stack_counter.bag.scan_file import IMAGES, Received, Recording, rescue
from stack_counter.errors import ConfigError
from stack_counter.views.tf_buffer import KEEP_NS

_FLUSH_S = 1.0  # longest time that a message is in memory only
_BACKLOG_BYTES = 256_000_000  # messages that wait for the disk: seconds of a camera
_SAMPLES = 100_000  # transforms kept from before a scan, at most


class Recorder:
    """Takes all messages that a scan may need; writes those of scans."""

    def __init__(self, folder: Path, max_mb: float, warn: Callable[[str], object]):
        """Makes the folder, and makes what a crash has left there usable.

        Args:
            folder: where to; files in it that no recorder has made are never touched.
            max_mb: bound on all recordings together, MB.
            warn: told one line when a recording ends early; called from another thread.

        Raises:
            ConfigError: the folder cannot be made or written to.
        """
        self._folder, self._warn = folder, warn
        self._max_bytes = round(max_mb * 1e6)
        self._before = _Before()
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._given = self._taken = 0  # bytes put into the queue and got from it
        self._on = False  # messages go into the queue
        self._last_ns = 0
        self._open: Recording | None = None  # like all below, of the thread alone
        self._others = 0  # bytes of the finished recordings
        self._flushed = 0.0
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(f"{folder} is not writable")
            for path in rescue(folder):
                warn(f"a recording was not finished; it can be read up to its end: {path}")
        except OSError as error:
            raise ConfigError(f"record_folder is '{folder}': {error}; expected a folder that can "
                              "be written to") from error
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    # --- for who scans ------------------------------------------------------------------------

    def take(self, message: Received, key: Hashable = None) -> None:
        """Takes a message: into the file if a scan is open, and to be remembered for the next.

        Args:
            message: images belong to open scans only; of the others what the next scan can use
                is remembered.
            key: a message replaces the last one with this key; None: all of the last minute
                count.
        """
        # Replay reads in this order, and so sees what the scan saw even if the clock is put back.
        self._last_ns = max(message.received_ns, self._last_ns + 1)
        message = message._replace(received_ns=self._last_ns)
        if message.kind not in IMAGES:
            self._before.add(message, key)
        if not self._on:
            return
        if self._given - self._taken > _BACKLOG_BYTES:
            self._on = False
            self._queue.put(partial(self._cut, f"{_BACKLOG_BYTES / 1e6:.0f} MB wait for the disk; "
                                               "expected one that keeps up with the camera"))
            return
        self._given += len(message.data)
        self._queue.put(partial(self._write, message))

    def start(self, facts: dict[str, str]) -> None:
        """A scan begins; `facts` are stored with it, among them its `scan_id`."""
        self.stop("the next scan")
        self._on = True
        self._last_ns = max(time.time_ns(), self._last_ns + 1)
        self._queue.put(partial(self._begin, facts, self._before.messages(), self._last_ns))

    def stop(self, ended: str, overrun: Sequence[tuple[str, int]] = ()) -> None:
        """Nothing more of the scan will come.

        Args:
            ended: what ended it.
            overrun: camera and stamp of the views that it had no time for; not to be counted.
        """
        if self._on:
            self._on = False
            lost = {"overrun": json.dumps(overrun)} if overrun else {}
            self._queue.put(partial(self._end, {"ended": ended, **lost}))

    def close(self) -> None:
        """Finishes what is open and waits until it is written."""
        self.stop("shutdown")
        self._queue.put(None)
        self._thread.join()

    # --- the thread ---------------------------------------------------------------------------

    def _work(self) -> None:
        while True:
            try:
                task = self._queue.get(timeout=_FLUSH_S)
            except queue.Empty:
                task = self._flush
            if task is None:
                return
            try:
                task()
            except Exception as error:  # whatever it is, scans go on and the next is recorded
                self._give_up(error)

    def _begin(self, facts: dict[str, str], before: list[Received], now_ns: int) -> None:
        self._others = sum(path.stat().st_size for path in finished(self._folder))
        self._open = Recording(self._folder, facts, now_ns)
        for i, message in enumerate(before, now_ns - len(before)):
            # At the scan's start: a player need not wait for it since the node's start.
            self._add(message._replace(received_ns=i))
        self._flush()

    def _write(self, message: Received) -> None:
        self._taken += len(message.data)
        self._add(message)
        if message.kind in IMAGES or time.monotonic() - self._flushed > _FLUSH_S:
            self._flush()

    def _add(self, message: Received) -> None:
        if self._open is None:
            return
        if self._has_room(self._open.size_with(len(message.data))):
            self._open.write(message)
        else:
            self._cut(f"the scan alone takes {self._max_bytes / 1e6:g} MB; expected less than "
                      "record_max_mb")

    def _has_room(self, size: int) -> bool:
        """Deletes the oldest recordings until a file of this size finds room, if it can."""
        if size > self._max_bytes:
            return False
        if self._others + size > self._max_bytes:
            for path in finished(self._folder):
                self._others -= path.stat().st_size
                path.unlink()
                if self._others + size <= self._max_bytes:
                    break
        return True

    def _flush(self) -> None:
        self._flushed = time.monotonic()
        if self._open is not None:
            self._open.flush()

    def _end(self, facts: dict[str, str]) -> None:
        if self._open is not None:
            self._open.finish(facts)
            self._open = None

    def _cut(self, reason: str) -> None:
        if self._open is not None:
            self._open.finish({"ended": f"cut: {reason}"}, whole=False)
            scan_id, self._open = self._open.facts["scan_id"], None
            self._warn(f"recording of scan '{scan_id}' is cut, the scan goes on: {reason}")

    def _give_up(self, error: Exception) -> None:
        recording, self._open = self._open, None
        if recording is not None:
            recording.discard()  # a full disk is needed by others
        self._warn(f"recording stopped and removed, the scan goes on: {type(error).__name__}: "
                   f"{error}")


class _Before:
    """What came before a scan and can still matter in it, as the transform buffer keeps it."""

    def __init__(self) -> None:
        self._latest: dict[Hashable, Received] = {}
        self._samples: deque[Received] = deque(maxlen=_SAMPLES)

    def add(self, message: Received, key: Hashable) -> None:
        if key is not None:
            self._latest[key] = message
            return
        self._samples.append(message)
        while self._samples[0].received_ns < message.received_ns - KEEP_NS:
            self._samples.popleft()

    def messages(self) -> list[Received]:
        """In the order in which they came."""
        return sorted([*self._latest.values(), *self._samples], key=lambda m: m.received_ns)
