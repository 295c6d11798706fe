# SPDX-License-Identifier: Apache-2.0
"""The size that an image file states, read before anything is made room for."""

from __future__ import annotations

import io
import struct

import imagesize

from stack_counter.errors import ViewError
from stack_counter.views.decoding.pixels import MAX_PIXELS, is_camera_size

_PNG = b"\x89PNG\r\n\x1a\n"


def check_stated_size(data: bytes | memoryview, name: str, most: int = MAX_PIXELS) -> None:
    """Refuses what is no image file of a camera's size: OpenCV would make room for it.

    Args:
        data: of the file: JPEG, PNG, WebP, TIFF or another that states its size in its head.
        name: format as the message states it, for the error.
        most: pixels that it may have.

    Raises:
        ViewError: reason `bad_image`.
    """
    try:
        width, height = imagesize.get(io.BytesIO(data))
    except (ValueError, struct.error):
        width, height = -1, -1
    if width < 0 or height < 0:
        raise ViewError("bad_image", f"{len(data)} bytes of '{name}' do not decode; "
                                     "expected a JPEG or PNG image each (no video, as H.264: "
                                     "record raw images or such of image_transport)")
    if not is_camera_size(width, height, most):
        raise ViewError("bad_image", f"{width}x{height} pixels in {len(data)} bytes of '{name}'; "
                                     f"expected 1 to {most} pixels")
    if bytes(data[:len(_PNG)]) == _PNG:
        _check_png_chunks(data, name)


def _check_png_chunks(data: bytes | memoryview, name: str) -> None:
    """Refuses a PNG file with a chunk longer than the file: OpenCV would make room for it."""
    at = len(_PNG)
    while at + 8 <= len(data) and bytes(data[at + 4:at + 8]) != b"IEND":
        length = int.from_bytes(data[at:at + 4], "big")
        at += length + 12  # with length, kind and check sum
        if at > len(data):
            raise ViewError("bad_image", f"a chunk of {length} bytes in {len(data)} bytes of "
                                         f"'{name}'; expected a whole PNG image")
