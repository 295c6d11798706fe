# SPDX-License-Identifier: Apache-2.0
"""One .mcap file, whole or cut short, as blocks that can be read in log-time order.

The library's readers need the index at the end of the file, or give up inside the record that is
cut. This one walks the file once from record header to record header; it decompresses nothing
where statistics at the end count the messages. A last chunk that ends early gives the messages
that are whole.
"""

from __future__ import annotations

import io
import struct
import zlib
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import lz4.frame
import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Metadata, Schema, Statistics

from stack_counter.errors import BagError

_MAGIC = b"\x89MCAP0\r\n"
# Format of a record's header: opcode, length of its content.
_RECORD_HEADER = struct.Struct("<BQ")
# Format of a message's head: channel, sequence, log time, publish time.
_MESSAGE_HEAD = struct.Struct("<HIQQ")
# Bytes decompressed at a time: what precedes damage is kept.
_DECOMPRESS_BYTES = 1 << 16


class Block(NamedTuple):
    """A chunk, or a message outside of chunks: what is read at once.

    Attributes:
        start_ns: earliest log time in it, ns.
        offset: of the record's content in the file, bytes.
        opcode: of the record.
        length: of the record's content, bytes; it may reach beyond the end of a file cut short.
    """

    start_ns: int
    offset: int
    opcode: int
    length: int


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


class McapFile:
    """The content of one .mcap file.

    Attributes:
        channels: channels by number.
        schemas: message definitions by number.
        counts: number of messages by number of channel.
        metadata: values by key, by name of the metadata.
        blocks: chunks and messages outside of chunks, in file order.
        truncated: whether the file ends early, or a part of it is damaged and was left out.
    """

    def __init__(self, path: Path):
        """Walks through the file.

        Raises:
            BagError: the file is no mcap file, or is compressed in an unknown way.
        """
        self.path = path
        self.channels: dict[int, Channel] = {}
        self.schemas: dict[int, Schema] = {}
        self.counts: Counter[int] = Counter()
        self.metadata: dict[str, dict[str, str]] = {}
        self.blocks: list[Block] = []
        self.truncated = True
        with open(path, "rb") as file:
            magic = file.read(len(_MAGIC))
            if magic != _MAGIC:
                raise BagError(f"{path} is not an mcap file: it begins with {magic!r}; expected "
                               f"{_MAGIC!r}")
            counted = self._walk_records(file)
        # Without statistics, or if something is missing, count what can be read.
        if not counted or self.truncated:
            self.counts = Counter(message.channel_id for block in self.blocks
                                  for message in self.load(block))

    def _walk_records(self, file: io.BufferedReader) -> bool:
        """Lists the blocks; returns whether statistics have counted their messages."""
        size, counted = self.path.stat().st_size, False
        while len(header := file.read(_RECORD_HEADER.size)) == _RECORD_HEADER.size:
            opcode, length = _RECORD_HEADER.unpack(header)
            start = file.tell()
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                self._list_block(file, opcode, length, size)
            elif start + length > size or opcode == 0:  # cut, or space set aside, never written
                return counted
            elif opcode == Opcode.FOOTER:
                file.seek(start + length)
                self.truncated = file.read(len(_MAGIC)) != _MAGIC
                return counted
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(_stream(file.read(length)))
                self.counts.update(statistics.channel_message_counts)
                counted = set(self.counts) <= set(self.channels)
            else:
                self._read_definition(opcode, length, file)
            file.seek(start + length)
        return counted

    def _list_block(self, file: io.BufferedReader, opcode: int, length: int, size: int) -> None:
        """Adds the block at the file's place; a message outside of chunks must be whole."""
        offset, head = file.tell(), file.read(_MESSAGE_HEAD.size)
        whole = offset + length <= size
        if len(head) == _MESSAGE_HEAD.size and (whole or opcode == Opcode.CHUNK):
            start_ns = _MESSAGE_HEAD.unpack(head)[2] if opcode == Opcode.MESSAGE \
                else struct.unpack_from("<Q", head)[0]
            self.blocks.append(Block(start_ns, offset, opcode, length))

    def _read_definition(self, opcode: int, length: int,
                         source: io.BufferedReader | io.BytesIO) -> None:
        """Keeps a schema, channel or metadata; other records are skipped."""
        if opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(source.read(length)))
            self.schemas[schema.id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(_stream(source.read(length)))
            self.channels[channel.id] = channel
        elif opcode == Opcode.METADATA:
            metadata = Metadata.read(_stream(source.read(length)))
            self.metadata.setdefault(metadata.name, {}).update(metadata.metadata)

    def load(self, block: Block) -> list[RawMessage]:
        """Messages of a block, in file order; of a block cut short, those that are whole.

        Raises:
            BagError: the block is compressed in an unknown way.
        """
        with open(self.path, "rb") as file:
            file.seek(block.offset)
            content = file.read(block.length)
        if block.opcode == Opcode.MESSAGE:
            return [_parse_message(content)]
        # Read and check the chunk, as far as it goes.
        try:
            chunk = Chunk.read(_stream(content))
        except (McapError, struct.error, UnicodeDecodeError):  # cut within the chunk's head
            self.truncated = True
            return []
        data = b"".join(_decompress(chunk, self.path))
        if len(data) != chunk.uncompressed_size:
            self.truncated = True
        elif chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            self.truncated = True
            return []
        return list(self._messages_of_chunk(data))

    def _messages_of_chunk(self, data: bytes) -> Iterator[RawMessage]:
        """Messages in a chunk's data that are whole; definitions between them are kept."""
        position = 0
        while position + _RECORD_HEADER.size <= len(data):
            opcode, length = _RECORD_HEADER.unpack_from(data, position)
            start = position + _RECORD_HEADER.size
            end = start + length
            if end > len(data):
                return
            if opcode == Opcode.MESSAGE and length >= _MESSAGE_HEAD.size:
                yield _parse_message(data[start:end])
            else:
                self._read_definition(opcode, length, io.BytesIO(data[start:end]))
            position = end


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _parse_message(content: bytes) -> RawMessage:
    channel_id, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(content)
    return RawMessage(log_time_ns, channel_id, content[_MESSAGE_HEAD.size:])


def _decompress(chunk: Chunk, path: Path) -> Iterator[bytes]:
    """The content of a chunk, as far as it can be decompressed."""
    if chunk.compression not in ("", "zstd", "lz4"):
        raise BagError(f"{path} is compressed by '{chunk.compression}'; expected zstd or lz4")
    if not chunk.compression:
        yield chunk.data
        return
    decompressor = zstandard.ZstdDecompressor().decompressobj() if chunk.compression == "zstd" \
        else lz4.frame.LZ4FrameDecompressor()
    try:
        for start in range(0, len(chunk.data), _DECOMPRESS_BYTES):
            yield decompressor.decompress(chunk.data[start:start + _DECOMPRESS_BYTES])
    except (zstandard.ZstdError, RuntimeError, EOFError):  # damaged or, with lz4, beyond the end
        return
