# SPDX-License-Identifier: Apache-2.0
"""The size that a JPEG or PNG file states, read before anything is made room for.

Source: PNG specification, 11.2.2 (IHDR comes first); ITU-T T.81, B.1 and B.2.2 (markers, frame
header).
"""

from __future__ import annotations

import struct

from stack_counter.errors import ViewError
from stack_counter.views.decoding.pixels import MAX_PIXELS, is_camera_size

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"
_PNG_SIZE_AT = 16
# Markers of a frame header, with the size: all of 0xC0 to 0xCF but Huffman and arithmetic tables.
_FRAMES = frozenset(range(0xC0, 0xD0)) - {0xC4, 0xC8, 0xCC}
_WITHOUT_LENGTH = frozenset((0x01, *range(0xD0, 0xD9)))


def check_stated_size(data: bytes | memoryview, name: str, most: int = MAX_PIXELS) -> None:
    """Refuses what is no JPEG or PNG file of a camera's size: OpenCV would make room for it.

    Args:
        data: of the file.
        name: format as the message states it, for the error.
        most: pixels that it may have.

    Raises:
        ViewError: reason `bad_image`.
    """
    width, height = _stated_size(data)
    if not width:
        raise ViewError("bad_image", f"{len(data)} bytes of '{name}' do not decode; "
                                     "expected a JPEG or PNG image")
    if not is_camera_size(width, height, most):
        raise ViewError("bad_image", f"{width}x{height} pixels in {len(data)} bytes of '{name}'; "
                                     f"expected 1 to {most} pixels")


def _stated_size(data: bytes | memoryview) -> tuple[int, int]:
    """Width and height that a file states, pixels; zeros where it is none or cut short."""
    head = bytes(data[:_PNG_SIZE_AT + 8])
    if head.startswith(_PNG) and len(head) == _PNG_SIZE_AT + 8:
        return struct.unpack_from(">II", head, _PNG_SIZE_AT)
    return _stated_size_of_jpeg(data) if head.startswith(_JPEG) else (0, 0)


def _stated_size_of_jpeg(data: bytes | memoryview) -> tuple[int, int]:
    """The same of a JPEG file: its segments are skipped up to the frame header."""
    at = 2
    while at + 9 <= len(data) and data[at] == 0xFF:
        marker = data[at + 1]
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            return width, height
        if marker == 0xFF:  # filled up
            at += 1
        elif marker in _WITHOUT_LENGTH:
            at += 2
        else:
            at += 2 + int.from_bytes(data[at + 2:at + 4], "big")
    return 0, 0
