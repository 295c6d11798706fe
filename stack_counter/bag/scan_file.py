"""One scan's messages in one .mcap file that can be read whatever ends its writer.

While it is written its name ends in `.part`, and what has been flushed can be read. One that is
finished has an index and is renamed in one step, so that a file ending in `.mcap` is never in use.
"""

from __future__ import annotations

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

import yaml
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from stack_counter.bag.record_names import FACTS, PART, cut, file_name, unfinished

IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_STORE = get_typestore(Stores.ROS2_JAZZY)
_CLOSING = 1 << 16  # bytes, more than definitions and statistics at the end of a file take
_OVERHEAD = 64  # bytes, more than head and index of one message take
_INDEX = 256  # bytes, more than the index of one chunk takes there
_FOREVER = {"sec": 9223372036, "nsec": 854775807}
_LATCHED = yaml.safe_dump([{
    "history": "keep_last", "depth": 100, "reliability": "reliable",
    "durability": "transient_local", "deadline": _FOREVER, "lifespan": _FOREVER,
    "liveliness": "automatic", "liveliness_lease_duration": _FOREVER,
    "avoid_ros_namespace_conventions": False}], sort_keys=False)


class Received(NamedTuple):
    """A message as a node received it."""

    topic: str
    kind: str  # e.g. sensor_msgs/msg/Image
    data: bytes  # CDR
    stamp_ns: int  # of its header
    received_ns: int


class Recording:
    """A file that is being written.

    Attributes:
        facts: what was recorded, as stored in the file.
    """

    def __init__(self, folder: Path, facts: dict[str, str], now_ns: int):
        """Makes the file, named by the time (ns since 1970) and `facts["scan_id"]`.

        Raises:
            OSError: it cannot be made.
        """
        self.facts = facts
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}
        self._unwritten = self._chunks = 0
        while (path := folder / file_name(facts["scan_id"], now_ns)).exists() \
                or path.with_name(path.name + PART).exists():  # the clock was put back
            now_ns += 10**6
        self._path, self._part = path, path.with_name(path.name + PART)
        self._file = open(self._part, "xb")
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)  # ends with the process
            self._writer = Writer(self._file, compression=CompressionType.ZSTD)
            self._writer.start("ros2", "stack_counter")
            self._writer.add_metadata(FACTS, facts)
            self._file.flush()
        except Exception:
            self.discard()
            raise

    def size_with(self, more: int) -> int:
        """Bytes that the finished file has at most, with so many bytes of messages more."""
        return self._file.tell() + self._unwritten + more + _CLOSING + _INDEX * self._chunks

    def write(self, message: Received) -> None:
        """Adds a message; log times must grow.

        Raises:
            OSError: e.g. the disk is full; then only `discard` is left to do.
        """
        channel = self._channels.get(message.topic) or self._channel(message.topic, message.kind)
        self._writer.add_message(channel, message.received_ns, message.data,
                                 max(message.stamp_ns, 0))
        self._unwritten += len(message.data) + _OVERHEAD

    def _channel(self, topic: str, kind: str) -> int:
        if kind not in self._schemas:
            text, _ = _STORE.generate_msgdef(kind, ros_version=2)
            self._schemas[kind] = self._writer.register_schema(kind, "ros2msg", text.encode())
        # What is latched must be latched when played: see rosbag2's metadata.
        qos = _LATCHED if topic == "/tf_static" else "[]"
        self._channels[topic] = self._writer.register_channel(
            topic, "cdr", self._schemas[kind], {"offered_qos_profiles": qos})
        return self._channels[topic]

    def flush(self) -> None:
        """Ends the chunk: if the process is killed, all messages up to here can be read.

        Raises:
            OSError: as `write`.
        """
        if self._unwritten:
            self._writer.flush()
            self._unwritten = 0
            self._chunks += 1

    def finish(self, facts: dict[str, str], whole: bool = True) -> None:
        """Writes the index and gives the file its name.

        Args:
            facts: stored in the file, among them what `ended` the recording.
            whole: false for one that ends before its scan; its name says so.

        Raises:
            OSError: as `write`.
        """
        self.flush()
        self._writer.add_metadata(FACTS, facts)
        self._writer.finish()
        self._file.flush()
        os.fsync(self._file.fileno())  # before the name: a power cut leaves no empty file
        self._part.rename(self._path if whole else cut(self._path))
        self._file.close()

    def discard(self) -> None:
        """Removes the file."""
        with suppress(OSError):  # what is buffered may not find room either
            self._file.close()
        self._part.unlink(missing_ok=True)


def rescue(folder: Path) -> list[Path]:
    """Gives what a crash has left behind a finished name that says `cut`; returns the files."""
    found = []
    for part in unfinished(folder):
        with open(part, "r+b") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:  # another process is writing it
                continue
            found.append(part.rename(cut(part.with_name(part.name.removesuffix(PART)))))
    return found
