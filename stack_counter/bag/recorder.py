# SPDX-License-Identifier: Apache-2.0
"""Writes every scan to a file, in a thread of its own, within a bounded part of the disk.

The thread that scans hands messages over and never waits: a disk that is slow, full or gone ends
the recording, not the scan.
"""

from __future__ import annotations

import json
import os
import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Hashable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from stack_counter.bag.scan_file import (
    IMAGES,
    Received,
    Recording,
    finish_abandoned,
    finished_recordings,
)
from stack_counter.errors import ConfigError
from stack_counter.views import tf_buffer


@dataclass(frozen=True)
class RecorderSettings:
    """How much the recorder keeps in memory, and how long.

    Attributes:
        flush_s: longest time that a message is in memory only, s; chosen.
        max_backlog_bytes: messages that wait for the disk, bytes, above which the recording
            ends; chosen: some seconds of a camera.
        max_samples: number of transforms kept from before a scan; chosen.
    """

    flush_s: float = 1.0
    max_backlog_bytes: int = 256_000_000
    max_samples: int = 100_000


SETTINGS = RecorderSettings()


class Recorder:
    """Receives all messages that a scan may need; writes those of scans."""

    def __init__(self, folder: Path, max_mb: float, warn: Callable[[str], object]):
        """Makes the folder, and makes what a crash has left there usable.

        Args:
            folder: of the recordings; files in it that no recorder has made are never touched.
            max_mb: bound on all recordings together, MB.
            warn: called with one line when a recording ends early, from another thread.

        Raises:
            ConfigError: the folder cannot be made or written to.
        """
        self._folder, self._warn = folder, warn
        self._max_bytes = round(max_mb * 1e6)
        self._history = _MessageHistory()
        self._queue: queue.SimpleQueue[Callable[[], None] | None] = queue.SimpleQueue()
        self._queued_bytes = self._dequeued_bytes = 0
        self._scan_open = False  # whether messages go into the queue
        self._last_ns = 0
        # These belong to the writing thread alone.
        self._recording: Recording | None = None
        self._finished_bytes = 0  # of all finished recordings
        self._flushed_s = 0.0
        # Make the folder and finish what a crash has left in it.
        try:
            folder.mkdir(parents=True, exist_ok=True)
            if not os.access(folder, os.W_OK | os.X_OK):
                raise PermissionError(f"{folder} is not writable")
            for path in finish_abandoned(folder):
                warn(f"a recording was not finished; it can be read up to its end: {path}")
        except OSError as error:
            raise ConfigError(f"record_folder is '{folder}': {error}; expected a folder that can "
                              "be written to") from error
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    # --- called by the thread that scans ------------------------------------------------------

    def take(self, message: Received, key: Hashable = None) -> None:
        """Takes a message into the file of an open scan, and remembers it for the next one.

        Args:
            message: images belong to open scans only; of the others what the next scan can use
                is remembered.
            key: a message replaces the last one with this key; None: all of the last minute
                are kept.
        """
        # Make times grow: a replay reads in this order, even if the clock was put back.
        self._last_ns = max(message.received_ns, self._last_ns + 1)
        message = message._replace(received_ns=self._last_ns)
        if message.kind not in IMAGES:
            self._history.add(message, key)
        if not self._scan_open:
            return
        if self._queued_bytes - self._dequeued_bytes > SETTINGS.max_backlog_bytes:
            self._scan_open = False
            backlog_mb = SETTINGS.max_backlog_bytes / 1e6
            self._queue.put(partial(self._cut, f"{backlog_mb:.0f} MB wait for the disk; expected "
                                               "one that keeps up with the camera"))
            return
        self._queued_bytes += len(message.data)
        self._queue.put(partial(self._write, message))

    def start(self, facts: dict[str, str]) -> None:
        """Begins the recording of a scan; `facts` are stored, among them its `scan_id`."""
        self.stop("the next scan")
        self._scan_open = True
        self._last_ns = max(time.time_ns(), self._last_ns + 1)
        self._queue.put(partial(self._open_file, facts, self._history.messages(), self._last_ns))

    def stop(self, ended: str, overrun: Sequence[tuple[str, int]] = ()) -> None:
        """Ends the recording of a scan.

        Args:
            ended: what ended the scan.
            overrun: camera and stamp (ns) of the views that the scan had no time for, which a
                replay must not count.
        """
        if self._scan_open:
            self._scan_open = False
            lost = {"overrun": json.dumps(overrun)} if overrun else {}
            self._queue.put(partial(self._finish, {"ended": ended, **lost}))

    def close(self) -> None:
        """Finishes the open recording and waits until it is written."""
        self.stop("shutdown")
        self._queue.put(None)
        self._thread.join()

    # --- run by the writing thread ------------------------------------------------------------

    def _run(self) -> None:
        """Runs the tasks of the queue, and flushes where there is none for a while."""
        while True:
            try:
                task = self._queue.get(timeout=SETTINGS.flush_s)
            except queue.Empty:
                task = self._flush
            if task is None:
                return
            try:
                task()
            except Exception as error:  # whatever it is: scans go on, the next one is recorded
                self._abandon(error)

    def _open_file(self, facts: dict[str, str], before: list[Received], now_ns: int) -> None:
        """Makes the file of a scan, with the messages from before that matter in it."""
        self._finished_bytes = sum(path.stat().st_size
                                   for path in finished_recordings(self._folder))
        self._recording = Recording(self._folder, facts, now_ns)
        # Log them just before the scan: a player need not wait for the time since they came.
        for log_time_ns, message in enumerate(before, now_ns - len(before)):
            self._append(message._replace(received_ns=log_time_ns))
        self._flush()

    def _write(self, message: Received) -> None:
        self._dequeued_bytes += len(message.data)
        self._append(message)
        if message.kind in IMAGES or time.monotonic() - self._flushed_s > SETTINGS.flush_s:
            self._flush()

    def _append(self, message: Received) -> None:
        if self._recording is None:
            return
        if self._make_room(self._recording.size_with(len(message.data))):
            self._recording.write(message)
        else:
            self._cut(f"the scan alone takes {self._max_bytes / 1e6:g} MB; expected less than "
                      "record_max_mb")

    def _make_room(self, size: int) -> bool:
        """Deletes the oldest recordings until a file of this size finds room, if it can."""
        if size > self._max_bytes:
            return False
        if self._finished_bytes + size > self._max_bytes:
            for path in finished_recordings(self._folder):
                self._finished_bytes -= path.stat().st_size
                path.unlink()
                if self._finished_bytes + size <= self._max_bytes:
                    break
        return True

    def _flush(self) -> None:
        self._flushed_s = time.monotonic()
        if self._recording is not None:
            self._recording.flush()

    def _finish(self, facts: dict[str, str]) -> None:
        if self._recording is not None:
            self._recording.finish(facts)
            self._recording = None

    def _cut(self, reason: str) -> None:
        if self._recording is not None:
            self._recording.finish({"ended": f"cut: {reason}"}, whole=False)
            scan_id, self._recording = self._recording.facts["scan_id"], None
            self._warn(f"recording of scan '{scan_id}' is cut, the scan goes on: {reason}")

    def _abandon(self, error: Exception) -> None:
        recording, self._recording = self._recording, None
        if recording is not None:
            recording.discard()  # a full disk is needed by others
        self._warn(f"recording stopped and removed, the scan goes on: {type(error).__name__}: "
                   f"{error}")


class _MessageHistory:
    """Messages from before a scan that can still matter in it, as the transform buffer keeps."""

    def __init__(self) -> None:
        self._latest: dict[Hashable, Received] = {}
        self._samples: deque[Received] = deque(maxlen=SETTINGS.max_samples)

    def add(self, message: Received, key: Hashable) -> None:
        if key is not None:
            if key in self._latest or len(self._latest) < tf_buffer.SETTINGS.frames:
                self._latest[key] = message
            return
        self._samples.append(message)
        while self._samples[0].received_ns < message.received_ns - tf_buffer.SETTINGS.kept_ns:
            self._samples.popleft()

    def messages(self) -> list[Received]:
        """Messages in the order in which they came."""
        return sorted([*self._latest.values(), *self._samples], key=lambda m: m.received_ns)
