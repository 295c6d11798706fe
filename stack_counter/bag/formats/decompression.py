# SPDX-License-Identifier: Apache-2.0
"""Unpacks parts of recordings piece by piece: a few bytes may say that they are gigabytes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import lz4.frame
import zstandard

from stack_counter.errors import BagError


@dataclass(frozen=True)
class DecompressionSettings:
    """How much is unpacked; all are chosen.

    Attributes:
        piece_bytes: at a time, so that what precedes damage is kept.
        lz4_piece_bytes: of what so many compressed bytes unpack to, at a time.
        most_bytes: of one chunk or message: recorders' chunks have a few megabytes, the largest
            images some hundred.
    """

    piece_bytes: int = 1 << 16
    lz4_piece_bytes: int = 1 << 20
    most_bytes: int = 1 << 30


SETTINGS = DecompressionSettings()


def decompress_zstd(data: bytes) -> Iterator[bytes]:
    """The content of a frame, as far as the data reach.

    Raises:
        zstandard.ZstdError: the data are damaged.
        BagError: there is more than any recorder puts into one frame.
    """
    with zstandard.ZstdDecompressor().stream_reader(data) as reader:
        yield from _bounded(iter(lambda: reader.read(SETTINGS.piece_bytes), b""))


def decompress_lz4(data: bytes) -> Iterator[bytes]:
    """The content of a frame, as far as the data reach.

    Raises:
        RuntimeError: the data are damaged.
        EOFError: there are data behind the frame.
        BagError: there is more than any recorder puts into one frame.
    """
    yield from _bounded(_lz4_pieces(data))


def _lz4_pieces(data: bytes) -> Iterator[bytes]:
    """The content of a frame, a few pieces for each piece of the data."""
    decompressor = lz4.frame.LZ4FrameDecompressor()
    for start in range(0, len(data), SETTINGS.piece_bytes):
        packed = data[start:start + SETTINGS.piece_bytes]
        while piece := decompressor.decompress(packed, max_length=SETTINGS.lz4_piece_bytes):
            yield piece
            if decompressor.needs_input or decompressor.eof:
                break
            packed = b""


def _bounded(pieces: Iterator[bytes]) -> Iterator[bytes]:
    """The pieces, up to the largest size that is read."""
    size = 0
    for piece in pieces:
        size += len(piece)
        if size > SETTINGS.most_bytes:
            raise BagError(f"a compressed part unpacks to more than {SETTINGS.most_bytes >> 20} "
                           "MB; expected a recorder's chunk or message")
        yield piece
