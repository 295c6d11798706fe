# SPDX-License-Identifier: Apache-2.0
"""One .db3 file of rosbag2 (sqlite3), whole or cut short, read in log-time order."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Set
from contextlib import suppress
from pathlib import Path

import numpy as np

from stack_counter.bag.formats.recording_file import (
    NEVER_NS,
    Record,
    TopicDecoder,
    is_latched,
)
from stack_counter.errors import BagError

MAGIC = b"SQLite format 3\0"
_ROW = np.dtype([("id", np.int64), ("topic", np.int64), ("time", np.int64)])


class SqliteFile:
    """The content of one .db3 file; see `RecordingFile`.

    Its rows are listed once without their data, which is read row by row. A file that is cut
    lacks pages: its rows are listed up to the first one that is missing.
    """

    def __init__(self, path: Path):
        """Lists the messages.

        Raises:
            BagError: the file is no recording, or so much of it is missing that nothing is left.
        """
        self._path = path
        self.metadata: dict[str, dict[str, str]] = {}
        self.truncated = False
        # What was written last may still be in a log beside the file.
        log = path.with_name(f"{path.name}-wal").exists()
        self._database = sqlite3.connect(
            f"{path.absolute().as_uri()}?{'mode=ro' if log else 'immutable=1'}", uri=True,
            check_same_thread=False)
        # A file shorter than its first page says is refused but for this.
        self._database.execute("PRAGMA writable_schema=ON")
        try:
            self._decoders = self._read_topics()
        except sqlite3.DatabaseError as error:
            raise BagError(f"{path} is no rosbag2 database, or cut short before its first "
                           f"message: {error}; expected tables `topics` and `messages`"
                           ) from error
        self.latched = self._read_latched()
        self._rows = self._list_rows()
        # Sum up the messages of each topic.
        numbers, counts = np.unique(self._rows["topic"], return_counts=True)
        self.topics = {self._decoders[n].topic: (self._decoders[n].kind, int(count))
                       for n, count in zip(numbers.tolist(), counts) if n in self._decoders}
        self.start_ns = int(self._rows["time"].min(initial=NEVER_NS))
        self.end_ns = int(self._rows["time"].max(initial=0))
        self.size = path.stat().st_size

    def _read_topics(self) -> dict[int, TopicDecoder]:
        """Decoders by number of topic."""
        self._database.execute("SELECT id, topic_id, timestamp, data FROM messages LIMIT 0")
        texts: dict[str, str] = {}
        with suppress(sqlite3.OperationalError):  # there is no such table before ROS 2 Iron
            texts = dict(self._database.execute(
                "SELECT topic_type, encoded_message_definition FROM message_definitions "
                "WHERE encoding = 'ros2msg'"))
        rows = self._database.execute("SELECT id, name, type, serialization_format FROM topics")
        # Any value may stand in any column.
        return {number: TopicDecoder(topic, kind, str(texts.get(kind, "")), encoding)
                for number, topic, kind, encoding in rows
                if isinstance(number, int) and all(isinstance(text, str)
                                                   for text in (topic, kind, encoding))}

    def _read_latched(self) -> set[str]:
        """Topics of publishers who offered old messages; unknown before ROS 2 Foxy."""
        try:
            return {topic for topic, profiles in self._database.execute(
                "SELECT name, offered_qos_profiles FROM topics") if is_latched(str(profiles))}
        except sqlite3.DatabaseError as error:
            # There is no such column, or its part of the file is damaged.
            self.truncated = not isinstance(error, sqlite3.OperationalError)
            return set()

    def _list_rows(self) -> np.ndarray:
        """Number, topic and log time (ns) of all messages, by time; of equal times, as written."""

        def rows() -> Iterator[tuple[int, int, int]]:
            with suppress(sqlite3.DatabaseError):
                for row in self._database.execute(
                        "SELECT id, topic_id, timestamp FROM messages NOT INDEXED ORDER BY id"):
                    # Of a page that was never written, or is damaged.
                    if not all(isinstance(number, int) for number in row):
                        break
                    yield row
                else:
                    return
            self.truncated = True

        listed = np.fromiter(rows(), _ROW)
        # Data may be missing where the row is there.
        while self.truncated and len(listed) and not self._is_whole(int(listed["id"][-1])):
            listed = listed[:-1]
        return listed[np.argsort(listed["time"], kind="stable")]

    def _is_whole(self, number: int) -> bool:
        try:
            self._read(number)
        except sqlite3.DatabaseError:
            return False
        return True

    def _read(self, number: int) -> bytes:
        row = self._database.execute("SELECT data FROM messages WHERE id = ?",
                                     (number,)).fetchone()
        if row is None or not isinstance(row[0], bytes):
            raise sqlite3.DatabaseError(f"message {number} is no bytes")
        return row[0]

    def records(self, topics: Set[str], start_ns: int, end_ns: int) -> Iterator[Record]:
        """Messages of these topics in log-time order; of equal times, as they were written."""
        rows = self._rows_of(topics)
        for row in rows[(rows["time"] >= start_ns) & (rows["time"] < end_ns)]:
            try:
                data = self._read(int(row["id"]))
            except sqlite3.DatabaseError:  # a part of the file is damaged
                self.truncated = True
                continue
            yield self._decoders[int(row["topic"])].record(int(row["time"]), data)

    def times_ns(self, topics: Set[str]) -> np.ndarray:
        """Log times of the messages of these topics: (n,) int64, rising."""
        return self._rows_of(topics)["time"]

    def _rows_of(self, topics: Set[str]) -> np.ndarray:
        wanted = [n for n, decoder in self._decoders.items() if decoder.topic in topics]
        return self._rows[np.isin(self._rows["topic"], wanted)]
