# SPDX-License-Identifier: Apache-2.0
"""Reads recorded bags: rosbag2 folders and bare .mcap files, whole or cut short; no ROS needed."""

from __future__ import annotations

import heapq
import json
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import yaml
from mcap_ros2.decoder import DecoderFactory

from stack_counter.bag.mcap_file import McapFile, RawMessage
from stack_counter.bag.scan_file import END_FACTS, FACTS, finished_recordings
from stack_counter.errors import BagError

_TRANSIENT_LOCAL = 1  # durability, as recorders before Jazzy write it


@dataclass(frozen=True)
class Record:
    """One message as recorded.

    Attributes:
        topic: on which it was published.
        log_time_ns: time of recording, ns since 1970.
        data: serialised message, CDR.
        decode: makes the message of `data`; raises whatever the decoder raises.
    """

    topic: str
    log_time_ns: int
    data: bytes
    decode: Callable[[], Any]


class BagReader:
    """All files of a bag as one.

    Attributes:
        topics: type name and number of messages by topic, of topics that have messages.
        facts: what the collector stored with the recording of a scan, by key; else empty.
    """

    def __init__(self, path: Path):
        """Finds the files and what is in them.

        Raises:
            FileNotFoundError: there is no such path.
            BagError: the path is no mcap file, or a folder without one.
        """
        self._files = [McapFile(p) for p in _mcap_paths(path)]
        # Schemas are numbered within a file: each file has a decoder of its own.
        self._factories = [DecoderFactory() for _ in self._files]
        # Sum up the messages of each topic over the files.
        types: dict[str, str] = {}
        counts: Counter[str] = Counter()
        for file in self._files:
            for channel_id, count in file.counts.items():
                channel = file.channels.get(channel_id)
                schema = file.schemas.get(channel.schema_id) if channel else None
                if channel and schema and count:
                    types[channel.topic] = schema.name
                    counts[channel.topic] += count
        self.topics = {topic: (types[topic], counts[topic]) for topic in sorted(types)}
        self.facts = {key: value for file in self._files for name in (FACTS, END_FACTS)
                      for key, value in file.metadata.get(name, {}).items()}

    @property
    def overrun(self) -> set[tuple[str, int]]:
        """Camera and stamp (ns) of the views that the recorded scan had no time for."""
        return {(camera, stamp) for camera, stamp in json.loads(self.facts.get("overrun", "[]"))}

    @property
    def latched(self) -> set[str]:
        """Topics that were recorded from publishers who offer old messages to late subscribers."""
        return {channel.topic for file in self._files for channel in file.channels.values()
                if _is_latched(channel.metadata.get("offered_qos_profiles", ""))}

    @property
    def truncated(self) -> bool:
        """Whether a file ends early or is damaged, or its recording ended before the scan."""
        return any(file.truncated for file in self._files) \
            or self.facts.get("ended", "").startswith("cut")

    def records(self, topics: set[str]) -> Iterator[Record]:
        """Messages of these topics in log-time order; of equal times, in file order."""
        blocks = sorted((block.start_ns, number, block.offset, block)
                        for number, file in enumerate(self._files) for block in file.blocks)
        pending: list[tuple[int, int, int, int, RawMessage]] = []  # heap, the earliest first
        next_block = 0
        while pending or next_block < len(blocks):
            # Load every block that may hold a message as early as the earliest pending one.
            while next_block < len(blocks) and (not pending
                                                or blocks[next_block][0] <= pending[0][0]):
                _, number, offset, block = blocks[next_block]
                next_block += 1
                file = self._files[number]
                for place, message in enumerate(file.load(block)):
                    channel = file.channels.get(message.channel_id)
                    if channel and channel.topic in topics:
                        heapq.heappush(pending,
                                       (message.log_time_ns, number, offset, place, message))
            if pending:
                _, number, _, _, message = heapq.heappop(pending)
                yield self._record(number, message)

    def _record(self, number: int, message: RawMessage) -> Record:
        file = self._files[number]
        channel = file.channels[message.channel_id]
        schema = file.schemas.get(channel.schema_id)
        decoder = self._factories[number].decoder_for(channel.message_encoding, schema)
        if decoder is None:
            raise BagError(f"{channel.topic} is encoded as '{channel.message_encoding}', its type "
                           f"as '{schema.encoding if schema else ''}'; expected cdr, ros2msg")
        return Record(channel.topic, message.log_time_ns, message.data,
                      partial(decoder, message.data))


def _is_latched(profiles: str) -> bool:
    """Whether a recorder's YAML list of offered profiles has one of transient local durability."""
    try:
        return any(profile.get("durability") in ("transient_local", _TRANSIENT_LOCAL)
                   for profile in yaml.safe_load(profiles) or [])
    except (yaml.YAMLError, TypeError, AttributeError):
        return False


def _mcap_paths(path: Path) -> list[Path]:
    """Paths of the .mcap files of a bag."""
    if not path.exists():
        raise FileNotFoundError(f"no bag {path}; expected a rosbag2 folder or .mcap file")
    if path.is_file():
        return [path]
    paths = sorted(path.glob("*.mcap"))
    if not paths:
        raise BagError(f"no .mcap file in {path}; it holds "
                       f"{sorted(p.name for p in path.iterdir())[:8]}")
    if len(scans := finished_recordings(path)) > 1:
        raise BagError(f"{path} holds the recordings of {len(scans)} scans; expected one: name "
                       f"its file, e.g. {scans[-1]}")
    _check_metadata(path)
    return paths


def _check_metadata(folder: Path) -> None:
    """Refuses a rosbag2 folder that is compressed as a whole or lacks a file it names.

    A folder without metadata.yaml passes: a recorder that was killed leaves none.
    """
    try:
        metadata = yaml.safe_load((folder / "metadata.yaml").read_text())
        information = metadata["rosbag2_bagfile_information"]
        names, compression = information["relative_file_paths"], information.get(
            "compression_mode")
    except FileNotFoundError:
        return
    except (yaml.YAMLError, UnicodeDecodeError, TypeError, KeyError, AttributeError) as error:
        raise BagError(f"{folder / 'metadata.yaml'} is not a rosbag2 metadata file: "
                       f"{str(error).splitlines()[0]}") from error
    if str(compression or "none").lower() not in ("none", "storage"):
        raise BagError(f"{folder} is compressed by '{compression}'; expected none, or chunks "
                       "compressed within the .mcap file")
    missing = [name for name in names if not (folder / name).is_file()]
    if missing:
        raise BagError(f"{folder} lacks {', '.join(missing)}, named in its metadata.yaml")
