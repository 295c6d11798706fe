"""One .mcap file, whole or cut short, as blocks that can be read in log-time order.

The library's readers need the index at the end of the file, or give up inside the record that is
cut. Here the file is walked once from record header to record header (nothing is decompressed
where the statistics at the end say what is in it); a last chunk that ends early gives the
messages that are whole.
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
_HEADER = struct.Struct("<BQ")  # opcode and length of a record
_MESSAGE = struct.Struct("<HIQQ")  # channel, sequence, log time, publish time
_PIECE = 1 << 16  # bytes decompressed at a time: what precedes damage is kept


class Block(NamedTuple):
    """A chunk, or a message outside of chunks: what is read at once."""

    start_ns: int  # earliest log time in it
    offset: int  # of its record in the file
    opcode: int
    length: int  # of the record's content; may reach beyond the end of a file cut short


class RawMessage(NamedTuple):
    """A message as recorded."""

    log_time_ns: int
    channel_id: int
    data: bytes


class McapFile:
    """The content of one file.

    Attributes:
        channels: by number.
        schemas: by number.
        counts: messages by number of channel.
        metadata: values by key, of each name.
        blocks: in file order.
        truncated: the file ends early, or a part of it is damaged and was left out.
    """

    def __init__(self, path: Path):
        """Walks through the file.

        Raises:
            BagError: not an mcap file, or compressed in an unknown way.
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
            known = self._walk(file)
        if not known or self.truncated:
            self.counts = Counter(message.channel_id for block in self.blocks
                                  for message in self.load(block))

    def _walk(self, file: io.BufferedReader) -> bool:
        """Lists the blocks; returns whether statistics say what is in them."""
        size, known = self.path.stat().st_size, False
        while len(header := file.read(_HEADER.size)) == _HEADER.size:
            opcode, length = _HEADER.unpack(header)
            start = file.tell()
            if opcode in (Opcode.CHUNK, Opcode.MESSAGE):
                self._list_block(file, opcode, length, size)
            elif start + length > size or opcode == 0:  # 0: space set aside, never written
                return known
            elif opcode == Opcode.FOOTER:
                file.seek(start + length)
                self.truncated = file.read(len(_MAGIC)) != _MAGIC
                return known
            elif opcode == Opcode.STATISTICS:
                statistics = Statistics.read(_stream(file.read(length)))
                self.counts.update(statistics.channel_message_counts)
                known = set(self.counts) <= set(self.channels)
            else:
                self._define(opcode, length, file)
            file.seek(start + length)
        return known

    def _list_block(self, file: io.BufferedReader, opcode: int, length: int, size: int) -> None:
        offset, head = file.tell(), file.read(_MESSAGE.size)
        whole = offset + length <= size
        if len(head) == _MESSAGE.size and (whole or opcode == Opcode.CHUNK):
            start_ns = _MESSAGE.unpack(head)[2] if opcode == Opcode.MESSAGE \
                else struct.unpack_from("<Q", head)[0]
            self.blocks.append(Block(start_ns, offset, opcode, length))

    def _define(self, opcode: int, length: int, source: io.BufferedReader | io.BytesIO) -> None:
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
        """The messages of a block, in file order; of one cut short, those that are whole.

        Raises:
            BagError: compressed in an unknown way.
        """
        with open(self.path, "rb") as file:
            file.seek(block.offset)
            content = file.read(block.length)
        if block.opcode == Opcode.MESSAGE:
            return [_message(content)]
        try:
            chunk = Chunk.read(_stream(content))
        except (McapError, struct.error, UnicodeDecodeError):  # cut within the chunk's head
            self.truncated = True
            return []
        data = b"".join(_decompressed(chunk, self.path))
        if len(data) != chunk.uncompressed_size:
            self.truncated = True
        elif chunk.uncompressed_crc and zlib.crc32(data) != chunk.uncompressed_crc:
            self.truncated = True
            return []
        return list(self._messages(data))

    def _messages(self, data: bytes) -> Iterator[RawMessage]:
        at = 0
        while at + _HEADER.size <= len(data):
            opcode, length = _HEADER.unpack_from(data, at)
            at, end = at + _HEADER.size, at + _HEADER.size + length
            if end > len(data):
                return
            if opcode == Opcode.MESSAGE and length >= _MESSAGE.size:
                yield _message(data[at:end])
            else:
                self._define(opcode, length, io.BytesIO(data[at:end]))
            at = end


def _stream(content: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(content))


def _message(content: bytes) -> RawMessage:
    channel_id, _, log_time_ns, _ = _MESSAGE.unpack_from(content)
    return RawMessage(log_time_ns, channel_id, content[_MESSAGE.size:])


def _decompressed(chunk: Chunk, path: Path) -> Iterator[bytes]:
    """The content of a chunk, as far as it can be decompressed."""
    if chunk.compression not in ("", "zstd", "lz4"):
        raise BagError(f"{path} is compressed by '{chunk.compression}'; expected zstd or lz4")
    if not chunk.compression:
        yield chunk.data
        return
    decompressor = zstandard.ZstdDecompressor().decompressobj() if chunk.compression == "zstd" \
        else lz4.frame.LZ4FrameDecompressor()
    try:
        for at in range(0, len(chunk.data), _PIECE):
            yield decompressor.decompress(chunk.data[at:at + _PIECE])
    except (zstandard.ZstdError, RuntimeError, EOFError):  # damaged or, with lz4, beyond the end
        return
