# SPDX-License-Identifier: Apache-2.0
"""Where the messages of an .mcap file are: by the index at its end, or by one walk through it.

A file cut short has no index. The walk goes from record header to record header; chunks are
counted by the small indexes that follow them, so that only the last one has to be decompressed.
"""

from __future__ import annotations

import io
import struct
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import ChunkIndex

from stack_counter.bag.formats.mcap_blocks import (
    DAMAGE,
    MESSAGE_HEAD,
    RECORD_HEADER,
    Block,
    McapDefinitions,
    read_block,
)
from stack_counter.errors import BagError

MAGIC = b"\x89MCAP0\r\n"
_FOOTER_BYTES = 20
# Format of the head of an index behind a chunk: channel, bytes of the entries of 16 that follow.
_INDEX_HEAD = struct.Struct("<HI")
_INDEX_ENTRY_BYTES = 16


@dataclass(frozen=True)
class McapIndexSettings:
    """How messages outside of chunks are read.

    Attributes:
        run_bytes: so many of them at once, as large as a common chunk; chosen.
    """

    run_bytes: int = 4 << 20


SETTINGS = McapIndexSettings()


class McapIndex:
    """What is in an .mcap file, and where.

    Attributes:
        definitions: channels, types and metadata.
        blocks: chunks and runs of messages outside of chunks, in file order.
        counts: number of messages by number of channel.
        truncated: whether the file ends early.
    """

    def __init__(self, path: Path):
        """Reads the index, or walks through the file.

        Raises:
            BagError: the file is no mcap file, or is compressed in an unknown way.
        """
        self._path = path
        self.definitions = McapDefinitions()
        self.blocks: list[Block] = []
        self.counts: Counter[int] = Counter()
        self.truncated = True
        with open(path, "rb") as file:
            magic = file.read(len(MAGIC))
            if magic != MAGIC:
                raise BagError(f"{path} is not an mcap file: it begins with {magic!r}; expected "
                               f"{MAGIC!r}")
            self.truncated = not _has_footer(file)
            if self.truncated or not self._read_summary(file):
                self._walk_records(file)
                self._read_unindexed()

    # --- by the index at the end --------------------------------------------------------------

    def _read_summary(self, file: io.BufferedReader) -> bool:
        """Takes the index at the end of the file, if that tells of all messages."""
        try:
            reader = make_reader(file)
            summary = reader.get_summary()
            if summary is None or (statistics := summary.statistics) is None:
                return False
            size = self._path.stat().st_size
            if any(c.chunk_start_offset + c.chunk_length > size for c in summary.chunk_indexes):
                return False
            told = len(summary.chunk_indexes), len(summary.metadata_indexes)
            if told != (statistics.chunk_count, statistics.metadata_count) \
                    or (statistics.message_count and not summary.chunk_indexes) \
                    or not set(statistics.channel_message_counts) <= set(summary.channels) \
                    or not {c.schema_id for c in summary.channels.values()
                            } <= {0, *summary.schemas}:
                return False
            metadata = list(reader.iter_metadata())
        except DAMAGE:
            return False
        for one in metadata:
            self.definitions.add_metadata(one)
        self.definitions.channels.update(summary.channels)
        self.definitions.schemas.update(summary.schemas)
        self.counts.update(statistics.channel_message_counts)
        self.blocks = [_indexed_block(chunk) for chunk in
                       sorted(summary.chunk_indexes, key=lambda chunk: chunk.chunk_start_offset)]
        return True

    # --- by a walk through the file -----------------------------------------------------------

    def _walk_records(self, file: io.BufferedReader) -> None:
        """Lists the blocks, and counts the messages of those that are indexed."""
        file.seek(len(MAGIC))
        size, start = self._path.stat().st_size, len(MAGIC)
        indexed: Counter[int] = Counter()  # messages of the last chunk, by its indexes so far
        after_chunk = False
        while len(header := file.read(RECORD_HEADER.size)) == RECORD_HEADER.size:
            opcode, length = RECORD_HEADER.unpack(header)
            start += RECORD_HEADER.size
            whole = start + length <= size
            if opcode == 0:  # space set aside, never written
                return
            if opcode == Opcode.MESSAGE_INDEX and whole and after_chunk \
                    and length >= _INDEX_HEAD.size:
                channel, entries = _INDEX_HEAD.unpack(file.read(_INDEX_HEAD.size))
                indexed[channel] += entries // _INDEX_ENTRY_BYTES
            else:  # the chunk before, if it is one, has all its indexes
                if indexed:
                    self.blocks[-1] = self.blocks[-1]._replace(channels=frozenset(indexed))
                    self.counts.update(indexed)
                    indexed = Counter()
                after_chunk = opcode == Opcode.CHUNK
            if opcode == Opcode.CHUNK:
                self._list_chunk(start, length, file.read(16))
            elif opcode == Opcode.MESSAGE and whole and length >= MESSAGE_HEAD.size:
                self._list_message(start, length, file.read(MESSAGE_HEAD.size))
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL, Opcode.METADATA):
                if whole:
                    self.definitions.read(opcode, file.read(length))
            if opcode == Opcode.FOOTER or not whole:
                self.truncated |= not whole
                return
            start += length
            file.seek(start)

    def _list_chunk(self, offset: int, length: int, times: bytes) -> None:
        """Adds a chunk, of which earliest and latest log time are read."""
        if len(times) == 16 and length >= 16:
            start_ns, end_ns = struct.unpack("<QQ", times)
            self.blocks.append(Block(start_ns, end_ns, offset, length, True, None))

    def _list_message(self, start: int, length: int, head: bytes) -> None:
        """Adds a message outside of chunks to the run that it follows, or begins one."""
        channel, _, log_time_ns, _ = MESSAGE_HEAD.unpack(head)
        self.counts[channel] += 1
        offset, end = start - RECORD_HEADER.size, start + length
        run = self.blocks[-1] if self.blocks else None
        if run is None or run.is_chunk or run.offset + run.length != offset \
                or run.length >= SETTINGS.run_bytes:
            self.blocks.append(Block(log_time_ns, log_time_ns, offset, end - offset, False,
                                     frozenset((channel,))))
            return
        assert run.channels is not None  # for the type checker
        channels = run.channels if channel in run.channels else run.channels | {channel}
        self.blocks[-1] = Block(min(run.start_ns, log_time_ns), max(run.end_ns, log_time_ns),
                                run.offset, end - run.offset, False, channels)

    def _read_unindexed(self) -> None:
        """Counts the chunks without indexes, and reads definitions that only chunks hold."""
        for place, block in enumerate(self.blocks):
            if block.channels is not None and block.channels <= self.definitions.known_channels:
                continue
            messages, whole = read_block(self._path, block, self.definitions)
            self.truncated |= not whole
            if block.channels is None:
                counts = Counter(message.channel_id for message in messages)
                self.counts.update(counts)
                self.blocks[place] = block._replace(channels=frozenset(counts))


def _has_footer(file: io.BufferedReader) -> bool:
    """Whether the file ends as a finished one does."""
    tail_bytes = RECORD_HEADER.size + _FOOTER_BYTES + len(MAGIC)
    file.seek(0, io.SEEK_END)
    if file.tell() < len(MAGIC) + tail_bytes:
        return False
    file.seek(-tail_bytes, io.SEEK_END)
    tail = file.read()
    return tail.endswith(MAGIC) and tail.startswith(
        RECORD_HEADER.pack(Opcode.FOOTER, _FOOTER_BYTES))


def _indexed_block(chunk: ChunkIndex) -> Block:
    """The block of an indexed chunk; recorders may be told to leave out what is in each."""
    return Block(chunk.message_start_time, chunk.message_end_time,
                 chunk.chunk_start_offset + RECORD_HEADER.size,
                 chunk.chunk_length - RECORD_HEADER.size, True,
                 frozenset(chunk.message_index_offsets) or None)
