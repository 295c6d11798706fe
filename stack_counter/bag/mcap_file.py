"""Messages of one .mcap file in log-time order; of one cut short, all that are whole."""

from __future__ import annotations

import io
import struct
from collections.abc import Iterator
from pathlib import Path

import zstandard
from mcap.data_stream import ReadDataStream
from mcap.exceptions import EndOfFile, McapError
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Channel, McapRecord, Message, Schema
from mcap.stream_reader import StreamReader

from stack_counter.errors import BagError

_MAGIC = b"\x89MCAP0\r\n"
# What the library raises where data ends or is damaged, by the place where it notices.
_CUT = (McapError, EndOfFile, struct.error, ValueError, KeyError, EOFError, MemoryError,
        zstandard.ZstdError)


class McapFile:
    """One file; `truncated` tells, after reading, whether it ended before its end."""

    def __init__(self, path: Path):
        """Checks the head and the tail of the file.

        Raises:
            BagError: not an mcap file.
        """
        self.path = path
        with open(path, "rb") as file:
            head = file.read(len(_MAGIC))
            size = file.seek(0, io.SEEK_END)
            file.seek(max(size - len(_MAGIC), 0))
            tail = file.read()
        if head != _MAGIC:
            raise BagError(f"{path} is not an mcap file: it begins with {head!r}; "
                           f"expected {_MAGIC!r}")
        self.truncated = tail != _MAGIC or size < 2 * len(_MAGIC)

    def messages(self) -> Iterator[tuple[Schema, Channel, Message]]:
        """Schema, channel and message, as the library's own reader gives them."""
        if self.truncated:
            yield from self._salvaged()
            return
        with open(self.path, "rb") as file:
            try:
                for schema, channel, message in make_reader(file).iter_messages():
                    if schema is not None:
                        yield schema, channel, message
            except _CUT:
                self.truncated = True

    def _salvaged(self) -> Iterator[tuple[Schema, Channel, Message]]:
        schemas: dict[int, Schema] = {}
        channels: dict[int, Channel] = {}
        for record in self._records():
            if isinstance(record, Schema):
                schemas[record.id] = record
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and record.channel_id in channels:
                channel = channels[record.channel_id]
                if channel.schema_id in schemas:
                    yield schemas[channel.schema_id], channel, record

    def _records(self) -> Iterator[McapRecord]:
        with open(self.path, "rb") as file:
            reader, begin = StreamReader(file, emit_chunks=False), len(_MAGIC)
            records = reader.records
            while True:
                try:
                    yield next(records)
                except StopIteration:
                    return
                except _CUT:
                    break
                begin = file.tell() if not isinstance(file, io.BytesIO) else begin
        yield from self._cut_chunk()

    def _cut_chunk(self) -> Iterator[McapRecord]:
        """The whole records of a last chunk that ends early."""
        data = self.path.read_bytes()
        begin = len(_MAGIC)
        while begin + 9 <= len(data):  # opcode and length of each top-level record
            opcode, length = struct.unpack_from("<BQ", data, begin)
            if begin + 9 + length > len(data):
                break
            begin += 9 + length
        else:
            return
        if opcode != Opcode.CHUNK:
            return
        try:
            name_at = begin + 9 + 8 + 8 + 8 + 4  # after times, size and checksum
            (name_length,) = struct.unpack_from("<I", data, name_at)
            compression = data[name_at + 4:name_at + 4 + name_length].decode()
            content = data[name_at + 4 + name_length + 8:]
            if compression == "zstd":
                content = zstandard.ZstdDecompressor().decompressobj().decompress(content)
            elif compression:
                return
            yield from _whole_records(content)
        except (*_CUT, UnicodeDecodeError):
            return


def _whole_records(content: bytes) -> Iterator[McapRecord]:
    kinds = {Opcode.SCHEMA: Schema, Opcode.CHANNEL: Channel}
    at = 0
    while at + 9 <= len(content):
        opcode, length = struct.unpack_from("<BQ", content, at)
        if at + 9 + length > len(content):
            return
        stream = ReadDataStream(io.BytesIO(content[at + 9:at + 9 + length]))
        if opcode == Opcode.MESSAGE:
            yield Message.read(stream, length)
        elif opcode in kinds:
            yield kinds[opcode].read(stream)
        at += 9 + length
