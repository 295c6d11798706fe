# SPDX-License-Identifier: Apache-2.0
"""Reads recorded bags of all formats, whole or cut short; no ROS needed.

A bag is never read as a whole: its files are indexed, and messages come one after the other.
"""

from __future__ import annotations

import copy
import heapq
import json
from collections import Counter, deque
from collections.abc import Iterable, Iterator, Set
from dataclasses import dataclass, replace
from operator import itemgetter
from pathlib import Path

import numpy as np

from stack_counter.bag.bag_paths import find_recordings
from stack_counter.bag.formats.opening import open_recording
from stack_counter.bag.formats.recording_file import NEVER_NS, Record, RecordingFile
from stack_counter.bag.scan_file import END_FACTS, FACTS
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.errors import BagError

STATIC_TF_TOPIC = "/tf_static"
_CAMERA_INFO = "sensor_msgs/msg/CameraInfo"


@dataclass(frozen=True)
class BagReaderSettings:
    """How a part of a bag is read.

    Attributes:
        margin_ns: how long before and after the part that is asked for messages other than colour
            images are read as well, ns: a view takes depth and transforms from around its image.
            Chosen: five times the gap of transforms that is interpolated in.
        look_back_ns: how far before the part calibrations are looked for at first, ns; then ten
            times as far, and so on. Chosen.
    """

    margin_ns: int = 5 * 10**8
    look_back_ns: int = 10**10


SETTINGS = BagReaderSettings()


class BagReader:
    """All files of a bag as one.

    Attributes:
        topics: type name and number of messages by topic, of topics that have messages.
        facts: what the collector stored with the recording of a scan, by key; else empty.
        start_ns: log time of the first message, ns since 1970; 0 without messages.
        duration_ns: from the first to the last message, ns.
        size: of the files, unpacked, bytes.
        time_range: the part of the bag that `records` gives.
    """

    def __init__(self, path: Path, time_range: TimeRange = WHOLE_BAG):
        """Finds the files and what is in them.

        Args:
            path: rosbag2 folder, or a file of a recording.
            time_range: what `records` gives.

        Raises:
            FileNotFoundError: there is no such path.
            BagError: the path is no recording, a folder without one, or shorter than the range.
        """
        self._files: list[RecordingFile] = [open_recording(p) for p in find_recordings(path)]
        # Sum up the messages of each topic over the files.
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for file in self._files:
            for topic, (kind, count) in file.topics.items():
                types[topic] = kind
                counts[topic] += count
        self.topics = {topic: (types[topic], counts[topic]) for topic in sorted(types)}
        self.facts = {key: value for file in self._files for name in (FACTS, END_FACTS)
                      for key, value in file.metadata.get(name, {}).items()}
        start_ns = min(file.start_ns for file in self._files)
        self.start_ns = start_ns if start_ns < NEVER_NS else 0
        self.duration_ns = max(max(file.end_ns for file in self._files) - self.start_ns, 0)
        self.size = sum(file.size for file in self._files)
        if time_range.start_ns > self.duration_ns:
            raise BagError(f"{path} lasts {self.duration_ns * 1e-9:.3f} s; expected more than "
                           f"{time_range.start_ns * 1e-9:g} s, where the part asked for begins")
        self.time_range = time_range

    @property
    def overrun(self) -> set[tuple[str, int]]:
        """Camera and stamp (ns) of the views that the recorded scan had no time for.

        Raises:
            BagError: the recording does not list them as the collector does.
        """
        text = self.facts.get("overrun", "[]")
        try:
            return {(str(camera), int(stamp)) for camera, stamp in json.loads(text)}
        except (TypeError, ValueError, OverflowError, RecursionError) as error:
            raise BagError(f"the recording's metadata 'overrun' is {text[:40]!r} ({error}); "
                           "expected a list of cameras with stamps, ns") from error

    @property
    def latched(self) -> set[str]:
        """Topics that were recorded from publishers who offer old messages to late subscribers."""
        return set().union(*(file.latched for file in self._files))

    @property
    def truncated(self) -> bool:
        """Whether a file ends early or is damaged, or its recording ended before the scan."""
        return any(file.truncated for file in self._files) \
            or self.facts.get("ended", "").startswith("cut")

    def frame_of(self, topic: str) -> str:
        """The camera frame that the first message of a topic names; empty where there is none."""
        record = next(self._records_between({topic}, 0, NEVER_NS), None)
        try:
            return record.decode().header.frame_id.lstrip("/") if record else ""
        except Exception:  # the decoder's errors are of many classes; who reads on will say it
            return ""

    def part(self, time_range: TimeRange) -> BagReader:
        """The same bag, of which `records` gives another part."""
        other = copy.copy(self)
        other.time_range = time_range
        return other

    def times_ns(self, topics: Set[str]) -> np.ndarray:
        """When these topics have messages: (n,) int64, ns after the beginning of the bag, rising.

        One time for each message, or for each chunk of a file that has some.
        """
        times = [file.times_ns(topics) for file in self._files]
        return np.sort(np.concatenate(times)) - self.start_ns

    def last_time_ns(self, topics: Set[str]) -> int:
        """Log time of the last message of these topics in the part, ns; its end without one."""
        end_ns = min(self.time_range.between(self.start_ns)[1],
                     self.start_ns + self.duration_ns + 1)
        last = [record.log_time_ns for record in self._last_before(topics, end_ns)]
        return last[0] if last else end_ns

    def records(self, topics: Set[str], color_topics: Set[str] = frozenset()) -> Iterator[Record]:
        """Messages of the part of the bag in log-time order; of equal times, in file order.

        Colour images are those of the part. Other messages come from a little before to a little
        after it; static transforms and the last calibrations before it come first, as if they
        were sent at its beginning.

        Args:
            topics: whose messages are wanted.
            color_topics: those of them with colour images.

        Raises:
            BagError: a message is damaged, or how it is serialised is not known.
        """
        if self.time_range == WHOLE_BAG:
            yield from self._records_between(topics, 0, NEVER_NS)
            return
        begin, end = self.time_range.between(self.start_ns)
        early = begin - SETTINGS.margin_ns
        for record in self._lasting_records(topics, early):
            yield replace(record, log_time_ns=max(early, self.start_ns))
        for record in self._records_between(topics, early, end + SETTINGS.margin_ns):
            if record.topic not in color_topics or begin <= record.log_time_ns < end:
                yield record

    def _records_between(self, topics: Set[str], start_ns: int, end_ns: int) -> Iterator[Record]:
        """Messages of all files by time; no file is read before its first message is due."""
        files = [_timed_records(file, topics, start_ns, end_ns) for file in self._files
                 if file.end_ns >= start_ns and file.start_ns < end_ns]
        for _, record in heapq.merge(*files, key=itemgetter(0)):
            if record is not None:
                yield record

    def _lasting_records(self, topics: Set[str], before_ns: int) -> Iterator[Record]:
        """What still holds at a time: static transforms, and the last calibration of a camera."""
        if STATIC_TF_TOPIC in topics:
            yield from self._records_between({STATIC_TF_TOPIC}, 0, before_ns)
        for topic in sorted(topics):
            if self.topics.get(topic, ("", 0))[0] == _CAMERA_INFO:
                yield from self._last_before({topic}, before_ns)

    def _last_before(self, topics: Set[str], before_ns: int) -> Iterable[Record]:
        """The last message of topics before a time, if there is one."""
        look_back = SETTINGS.look_back_ns
        while True:
            last = deque(self._records_between(topics, before_ns - look_back, before_ns), 1)
            if last or before_ns - look_back <= self.start_ns:
                return last
            look_back *= 10


def _timed_records(file: RecordingFile, topics: Set[str], start_ns: int, end_ns: int
                   ) -> Iterator[tuple[int, Record | None]]:
    """Times and records of a file; the first, without a record, reads nothing yet."""
    yield file.start_ns, None
    for record in file.records(topics, start_ns, end_ns):
        yield record.log_time_ns, record
