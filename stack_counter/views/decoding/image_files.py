# SPDX-License-Identifier: Apache-2.0
"""The size that an image file states, read before anything is made room for."""

from __future__ import annotations

import io
import struct

import imagesize

from stack_counter.errors import ViewError
from stack_counter.images import find_png_chunk_beyond
from stack_counter.views.decoding.pixels import MAX_PIXELS, is_camera_size


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
    if (length := find_png_chunk_beyond(data)) is not None:
        raise ViewError("bad_image", f"a chunk of {length} bytes in {len(data)} bytes of "
                                     f"'{name}'; expected a whole PNG image")
