# SPDX-License-Identifier: Apache-2.0
"""What an .mcap file is read by: chunks and runs of messages, of which a cut one keeps its whole.

The library's readers give up inside a record that is cut or damaged.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema

from stack_counter.bag.formats.decompression import decompress_lz4, decompress_zstd
from stack_counter.errors import BagError

# Format of a record's header: opcode, length of its content.
RECORD_HEADER = struct.Struct("<BQ")
# What the library raises inside a record that is cut or damaged.
DAMAGE = (McapError, struct.error, ValueError, OverflowError, MemoryError)
# Format of a message's head: channel, sequence, log time, publish time.
MESSAGE_HEAD = struct.Struct("<HIQQ")


class Block(NamedTuple):
    """A chunk, or messages outside of chunks that follow each other: what is read at once.

    Attributes:
        start_ns: earliest log time in it, ns.
        end_ns: latest log time in it, ns.
        offset: in the file of a chunk's content, or of the first message's record, bytes.
        length: bytes; it may reach beyond the end of a file cut short.
        is_chunk: whether it is a chunk.
        channels: numbers of the channels with messages in it; None: not known.
    """

    start_ns: int
    end_ns: int
    offset: int
    length: int
    is_chunk: bool
    channels: frozenset[int] | None


class RawMessage(NamedTuple):
    """A message as recorded.

    Attributes:
        log_time_ns: time of recording, ns.
        channel_id: number of its channel.
        data: serialised message.
    """

    log_time_ns: int
    channel_id: int
    data: bytes


class McapDefinitions:
    """What an .mcap file says of its messages, as far as it has been read.

    Attributes:
        channels: channels by number.
        schemas: definitions of types by number.
        metadata: values by key, by name of the metadata.
        damaged: whether one of them could not be read.
    """

    def __init__(self) -> None:
        """Makes one that knows nothing."""
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.metadata: dict[str, dict[str, str]] = {}
        self.damaged = False

    @property
    def known_channels(self) -> set[int]:
        """Numbers of the channels whose type has been read, or that have none."""
        return {number for number, channel in self.channels.items()
                if channel.schema_id in (0, *self.schemas)}

    def read(self, opcode: int, content: bytes) -> None:
        """Keeps a schema, channel or metadata; other records, and damaged ones, are skipped."""
        try:
            self._read(opcode, ReadDataStream(io.BytesIO(content)))
        except DAMAGE:
            self.damaged = True

    def _read(self, opcode: int, stream: ReadDataStream) -> None:
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(stream)
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(stream)
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            self.add_metadata(Metadata.read(stream))

    def add_metadata(self, metadata: Metadata) -> None:
        """Keeps metadata; what is said again under a name adds to what was said before."""
        self.metadata.setdefault(metadata.name, {}).update(metadata.metadata)


def read_block(path: Path, block: Block, definitions: McapDefinitions
               ) -> tuple[list[RawMessage], bool]:
    """Reads the messages of a block, and the definitions between them.

    Returns:
        The messages in file order, of a block cut short those that are whole; and whether the
        block is whole.

    Raises:
        BagError: the block is compressed in an unknown way.
    """
    with open(path, "rb") as file:
        file.seek(block.offset)
        content = file.read(min(block.length, path.stat().st_size))
    if not block.is_chunk:
        return list(_parse_records(content, definitions)), len(content) == block.length
    # Read and check the chunk, as far as it goes.
    try:
        chunk = Chunk.read(ReadDataStream(io.BytesIO(content)))
    except DAMAGE:  # cut within the chunk's head
        return [], False
    data = b"".join(_decompress(chunk, path))
    whole = len(data) == chunk.uncompressed_size
    if whole and chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
        return [], False
    return list(_parse_records(data, definitions)), whole


def _parse_records(data: bytes, definitions: McapDefinitions) -> Iterator[RawMessage]:
    """Messages that are whole; definitions between them are kept."""
    position = 0
    while position + RECORD_HEADER.size <= len(data):
        opcode, length = RECORD_HEADER.unpack_from(data, position)
        start = position + RECORD_HEADER.size
        position = start + length
        if position > len(data):
            return
        if opcode == Opcode.MESSAGE and length >= MESSAGE_HEAD.size:
            channel_id, _, log_time_ns, _ = MESSAGE_HEAD.unpack_from(data, start)
            yield RawMessage(log_time_ns, channel_id, data[start + MESSAGE_HEAD.size:position])
        else:
            definitions.read(opcode, data[start:position])


def _decompress(chunk: Chunk, path: Path) -> Iterator[bytes]:
    """The content of a chunk, as far as it can be decompressed."""
    if chunk.compression not in ("", "zstd", "lz4"):
        raise BagError(f"{path} is compressed by '{chunk.compression}'; expected zstd or lz4")
    if not chunk.compression:
        yield chunk.data
        return
    decompress = decompress_zstd if chunk.compression == "zstd" else decompress_lz4
    try:
        yield from decompress(chunk.data)
    except (zstandard.ZstdError, RuntimeError, EOFError, BagError):
        return  # damaged or, with lz4, beyond the end
