# SPDX-License-Identifier: Apache-2.0
"""One scan's messages in one .mcap file that can be read whatever ends its writer.

While a file is written its name ends in `.part`, and what has been flushed can be read. A finished
file has an index and is renamed in one step, so that a file ending in `.mcap` is never in use.
"""

from __future__ import annotations

import fcntl
import os
import re
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import yaml
from mcap.writer import CompressionType, Writer

from stack_counter.bag.message_definitions import message_definition

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
# Names of the mcap metadata that say what was recorded and, at its end, how it ended.
FACTS, END_FACTS = "stack_counter", "stack_counter_end"
_PART = ".part"
_CUT = ".cut"
# Names as `_file_name` makes them and no others: the bound on the disk deletes by this.
_NAME = re.compile(r"scan_\d{8}-\d{6}-\d{3}_[A-Za-z0-9_-]{1,40}(\.cut)?\.mcap")
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LATCHED = yaml.safe_dump([{
    "history": "keep_last", "depth": 100, "reliability": "reliable",
    "durability": "transient_local", "deadline": _FOREVER, "lifespan": _FOREVER,
    "liveliness": "automatic", "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False}], sort_keys=False)


@dataclass(frozen=True)
class OverheadBounds:
    """What an .mcap file takes at most besides its messages.

    Attributes:
        file: definitions and statistics at the end of a file, bytes; chosen, with ample room.
        message: head and index of one message, bytes; chosen, of some 40 that the format takes.
        chunk: index of one chunk at the end of the file, bytes; chosen, with ample room.
    """

    file: int = 1 << 16
    message: int = 64
    chunk: int = 256


BOUNDS = OverheadBounds()


class Received(NamedTuple):
    """A message as a node received it.

    Attributes:
        topic: on which it came.
        kind: type name, e.g. sensor_msgs/msg/Image.
        data: serialised message, CDR.
        stamp_ns: stamp of its header, ns.
        received_ns: time at which it came, ns since 1970.
    """

    topic: str
    kind: str
    data: bytes
    stamp_ns: int
    received_ns: int


class Recording:
    """A recording whose file is being written.

    Attributes:
        facts: what was recorded, by key, as stored in the file.
    """

    def __init__(self, folder: Path, facts: dict[str, str], now_ns: int):
        """Makes the file.

        Args:
            folder: of the recordings.
            facts: stored in the file, among them its `scan_id`, by which it is named.
            now_ns: time by which it is named, ns since 1970.

        Raises:
            OSError: the file cannot be made.
        """
        self.facts = facts
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._unwritten = self._chunks = 0
        # Take the next name that is free: the clock may have been put back.
        while (path := folder / _file_name(facts["scan_id"], now_ns)).exists() \
                or path.with_name(path.name + _PART).exists():
            now_ns += 10**6
        self._path, self._part = path, path.with_name(path.name + _PART)
        # Lock the file, which ends with the process, and write its head.
        self._file = open(self._part, "xb")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            # The library writes offsets of groups that are empty, which checkers of files
            # call an error: leave those optional records out.
            self._writer = Writer(self._file, compression=CompressionType.ZSTD,
                                  use_summary_offsets=False)
            self._writer.start("ros2", "stack_counter")
            self._writer.add_metadata(FACTS, facts)
            self._file.flush()
        except Exception:
            self.discard()
            raise

    def size_with(self, more: int) -> int:
        """Bytes that the finished file has at most, with `more` bytes of messages."""
        return (self._file.tell() + self._unwritten + more + BOUNDS.file
                + BOUNDS.chunk * self._chunks)

    def write(self, message: Received) -> None:
        """Adds a message; log times must grow.

        Raises:
            OSError: the disk is full or gone; then only `discard` is left to do.
        """
        channel = self._channels.get(message.topic) \
            or self._register_channel(message.topic, message.kind)
        self._writer.add_message(channel, message.received_ns, message.data,
                                 max(message.stamp_ns, 0))
        self._unwritten += len(message.data) + BOUNDS.message

    def _register_channel(self, topic: str, kind: str) -> int:
        """Adds a topic and, where it is new, its type; returns the channel's number."""
        if kind not in self._schemas:
            self._schemas[kind] = self._writer.register_schema(
                kind, "ros2msg", message_definition(kind).encode())
        # A latched topic must be latched again when rosbag2 plays the file.
        qos = _LATCHED if topic == "/tf_static" else "[]"
        self._channels[topic] = self._writer.register_channel(
            topic, "cdr", self._schemas[kind], {"offered_qos_profiles": qos})
        return self._channels[topic]

    def flush(self) -> None:
        """Ends the chunk: if the process is killed, all messages up to here can be read.

        Raises:
            OSError: the disk is full or gone; then only `discard` is left to do.
        """
        if self._unwritten:
            self._writer.flush()
            self._unwritten = 0
            self._chunks += 1

    def finish(self, facts: dict[str, str], whole: bool = True) -> None:
        """Writes the index and gives the file its name.

        Args:
            facts: stored in the file, among them what `ended` the recording.
            whole: false for a recording that ends before its scan; its name says so.

        Raises:
            OSError: the disk is full or gone; then only `discard` is left to do.
        """
        self.flush()
        self._writer.add_metadata(END_FACTS, facts)
        self._writer.finish()
        self._file.flush()
        # To the disk before it is renamed: a power cut leaves no empty file of a finished name.
        os.fsync(self._file.fileno())
        self._part.rename(self._path if whole else _cut_path(self._path))
        self._file.close()

    def discard(self) -> None:
        """Removes the file."""
        with suppress(OSError):  # what is buffered may not find room either
            self._file.close()
        self._part.unlink(missing_ok=True)


def finish_abandoned(folder: Path) -> list[Path]:
    """Gives recordings that a crash has left unfinished a finished name that says `cut`.

    Returns:
        Paths of the files, without those that another process is writing.
    """
    renamed = []
    for part in sorted(path for path in folder.glob(f"*{_PART}")
                       if _NAME.fullmatch(path.name.removesuffix(_PART)) and path.is_file()):
        with open(part, "r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:  # another process is writing it
                continue
            renamed.append(part.rename(_cut_path(part.with_name(part.name.removesuffix(_PART)))))
    return renamed


def finished_recordings(folder: Path) -> list[Path]:
    """Finished recordings of a folder, oldest first."""
    return sorted(p for p in folder.iterdir() if _NAME.fullmatch(p.name) and p.is_file())


def _file_name(scan_id: str, now_ns: int) -> str:
    """Name of a finished recording.

    The time (ns since 1970, written in UTC) comes first, so that names sort by age. No path
    leaves the folder, whatever the scan is called.
    """
    seconds, rest_ns = divmod(now_ns, 10**9)
    when = time.strftime("%Y%m%d-%H%M%S", time.gmtime(seconds))
    name = re.sub(r"[^A-Za-z0-9_-]+", "-", scan_id)[:40] or "scan"
    return f"scan_{when}-{rest_ns // 10**6:03d}_{name}.mcap"


def _cut_path(path: Path) -> Path:
    """Path of a finished recording that ended before its scan."""
    return path.with_suffix(f"{_CUT}{path.suffix}")
