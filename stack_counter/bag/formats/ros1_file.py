# SPDX-License-Identifier: Apache-2.0
"""One .bag file of ROS 1, whose messages come out as ROS 2 serialises and spells them."""

from __future__ import annotations

from collections.abc import Iterator, Set
from pathlib import Path

import numpy as np
from rosbags.rosbag1 import Reader

from stack_counter.bag.formats.recording_file import NEVER_NS, Record, TopicDecoder
from stack_counter.errors import BagError

MAGIC = b"#ROSBAG V"


class Ros1File:
    """The content of one .bag file; see `RecordingFile`."""

    def __init__(self, path: Path):
        """Reads the file's index.

        Raises:
            BagError: the file is encrypted, of an older format, or lacks its index.
        """
        self._path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.truncated = False
        self._reader = Reader(path)
        try:
            self._reader.open()
        except Exception as error:  # the library's are of many classes
            said = str(error).rstrip(".") or type(error).__name__
            raise BagError(f"{path} cannot be read: {said}; expected a bag of "
                           "ROS 1, version 2.0, not encrypted, with its index (`rosbag reindex` "
                           "makes it)") from error
        self._decoders = {c.id: TopicDecoder(c.topic, c.msgtype, encoding="ros1")
                          for c in self._reader.connections}
        self.latched = {c.topic for c in self._reader.connections
                        if getattr(c.ext, "latching", None)}
        counts: dict[str, int] = {}
        for connection in self._reader.connections:
            counts[connection.topic] = counts.get(connection.topic, 0) + connection.msgcount
        self.topics = {d.topic: (d.kind, counts[d.topic]) for d in self._decoders.values()
                       if counts[d.topic]}
        self.start_ns = self._reader.start_time if counts else NEVER_NS
        self.end_ns = self._reader.end_time - 1 if counts else 0  # the library's is exclusive
        self.size = path.stat().st_size

    def records(self, topics: Set[str], start_ns: int, end_ns: int) -> Iterator[Record]:
        """Messages of these topics in log-time order."""
        wanted = [c for c in self._reader.connections if c.topic in topics]
        if not wanted:  # the library would read all of them
            return
        try:
            for connection, log_time_ns, data in self._reader.messages(wanted, start_ns, end_ns):
                yield self._decoders[connection.id].record(log_time_ns, data)
        except BagError:
            raise
        except Exception as error:  # the library's are of many classes
            raise BagError(f"{self._path} is damaged: {error!r}; `rosbag reindex` keeps what is "
                           "whole") from error

    def times_ns(self, topics: Set[str]) -> np.ndarray:
        """Log times of the messages of these topics: (n,) int64, rising."""
        return np.sort(np.array([entry.time for c in self._reader.connections
                                 if c.topic in topics for entry in self._reader.indexes[c.id]],
                                np.int64))
