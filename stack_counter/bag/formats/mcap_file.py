# SPDX-License-Identifier: Apache-2.0
"""One .mcap file, whole or cut short, of which messages are read in log-time order."""

from __future__ import annotations

import heapq
from collections import Counter, OrderedDict
from collections.abc import Iterator, Set
from dataclasses import dataclass
from operator import itemgetter
from pathlib import Path

import numpy as np

from stack_counter.bag.formats.mcap_blocks import Block, RawMessage, read_block
from stack_counter.bag.formats.mcap_index import McapIndex
from stack_counter.bag.formats.recording_file import (
    NEVER_NS,
    Record,
    TopicDecoder,
    is_latched,
)

_TEXT_ENCODINGS = ("ros2msg", "ros1msg")


@dataclass(frozen=True)
class McapFileSettings:
    """How much of a file is held in memory.

    Attributes:
        cached_bytes: of messages of blocks that overlap in time; what does not fit is read again.
            Chosen: a recorder's chunks of 1 to 4 MB overlap by a few.
    """

    cached_bytes: int = 128 << 20


SETTINGS = McapFileSettings()


class McapFile:
    """The content of one .mcap file; see `RecordingFile`."""

    def __init__(self, path: Path):
        """Reads the file's index, or walks through a file that has none.

        Raises:
            BagError: the file is no mcap file, or is compressed in an unknown way.
        """
        self._path = path
        self._index = McapIndex(path)
        self._cache: OrderedDict[tuple[int, frozenset[int]], list[RawMessage]] = OrderedDict()
        self._cached_bytes = 0
        self._damaged = False
        self.metadata = self._index.definitions.metadata
        self._decoders = self._make_decoders()
        # Sum up the messages of each topic; of what has no type, nothing can be read.
        kinds = {d.topic: d.kind for d in self._decoders.values()}
        counts: Counter[str] = Counter()
        for number, count in self._index.counts.items():
            if number in self._decoders and count:
                counts[self._decoders[number].topic] += count
        self.topics = {topic: (kinds[topic], count) for topic, count in counts.items()}
        self.latched = {c.topic for c in self._index.definitions.channels.values()
                        if is_latched(c.metadata.get("offered_qos_profiles", ""))}
        blocks = [block for block in self._index.blocks
                  if block.channels or (block.channels is None and block.end_ns)]  # not empty
        self.start_ns = min((block.start_ns for block in blocks), default=NEVER_NS)
        self.end_ns = max((block.end_ns for block in blocks), default=0)
        self.size = path.stat().st_size

    @property
    def truncated(self) -> bool:
        """Whether the file ends early, or a part of it is damaged and was left out."""
        return self._index.truncated or self._damaged or self._index.definitions.damaged

    def _make_decoders(self) -> dict[int, TopicDecoder]:
        """Decoders by number of channel."""
        decoders = {}
        for channel in self._index.definitions.channels.values():
            schema = self._index.definitions.schemas.get(channel.schema_id)
            if schema is not None:
                text = schema.data.decode(errors="replace") \
                    if schema.encoding in _TEXT_ENCODINGS else ""
                decoders[channel.id] = TopicDecoder(channel.topic, schema.name, text,
                                                    channel.message_encoding)
        return decoders

    def records(self, topics: Set[str], start_ns: int, end_ns: int) -> Iterator[Record]:
        """Messages of these topics in log-time order; of equal times, in file order."""
        wanted = self._channels_of(topics)
        blocks = [self._block_messages(block, wanted, start_ns, end_ns)
                  for block in self._blocks_with(wanted)
                  if block.end_ns >= start_ns and block.start_ns < end_ns]
        for log_time_ns, message in heapq.merge(*blocks, key=itemgetter(0)):
            if message is not None:
                yield self._decoders[message.channel_id].record(log_time_ns, message.data)

    def times_ns(self, topics: Set[str]) -> np.ndarray:
        """Times of the blocks that hold messages of these topics: (n,) int64, rising."""
        return np.sort(np.array([min(block.start_ns, NEVER_NS) for block in
                                 self._blocks_with(self._channels_of(topics))], np.int64))

    def _channels_of(self, topics: Set[str]) -> frozenset[int]:
        return frozenset(n for n, decoder in self._decoders.items() if decoder.topic in topics)

    def _blocks_with(self, wanted: frozenset[int]) -> list[Block]:
        return [block for block in self._index.blocks
                if block.channels is None or block.channels & wanted]

    def _block_messages(self, block: Block, wanted: frozenset[int], start_ns: int, end_ns: int
                        ) -> Iterator[tuple[int, RawMessage | None]]:
        """Times and messages of a block; the first, without a message, reads nothing yet."""
        yield block.start_ns, None
        times = [(message.log_time_ns, place)
                 for place, message in enumerate(self._load(block, wanted))
                 if start_ns <= message.log_time_ns < end_ns]
        for log_time_ns, place in sorted(times):
            yield log_time_ns, self._load(block, wanted)[place]

    def _load(self, block: Block, wanted: frozenset[int]) -> list[RawMessage]:
        """Messages of a block on these channels, in file order."""
        key = (block.offset, wanted)
        if key not in self._cache:
            messages, whole = read_block(self._path, block, self._index.definitions)
            self._damaged |= not whole
            self._cache[key] = [m for m in messages if m.channel_id in wanted]
            self._cached_bytes += _bytes_of(self._cache[key])
            while self._cached_bytes > SETTINGS.cached_bytes and len(self._cache) > 1:
                self._cached_bytes -= _bytes_of(self._cache.popitem(last=False)[1])
        self._cache.move_to_end(key)
        return self._cache[key]


def _bytes_of(messages: list[RawMessage]) -> int:
    return sum(len(message.data) for message in messages)
