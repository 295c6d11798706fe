# SPDX-License-Identifier: Apache-2.0
"""Image files whose content may be damaged."""

from __future__ import annotations

import cv2
import numpy as np

PNG_HEAD = b"\x89PNG\r\n\x1a\n"


def decode_image(content: bytes, how: int) -> np.ndarray | None:
    """Decodes the content of an image file.

    Args:
        content: of the file.
        how: flags of OpenCV's `imdecode`, e.g. `cv2.IMREAD_GRAYSCALE`.

    Returns:
        (h, w) or (h, w, channels) pixels, channels in OpenCV's order; None where it does not
        decode.
    """
    if not content or find_png_chunk_beyond(content) is not None:
        return None
    try:
        return cv2.imdecode(np.frombuffer(content, np.uint8), how)
    except cv2.error:  # it states more pixels than OpenCV takes
        return None


def find_png_chunk_beyond(content: bytes | memoryview) -> int | None:
    """Finds a chunk of a PNG file that is longer than the file: OpenCV would make room for it.

    Returns:
        The length that it states, bytes; None where there is none, or the file is no PNG.
    """
    if bytes(content[:len(PNG_HEAD)]) != PNG_HEAD:
        return None
    at = len(PNG_HEAD)
    while at + 8 <= len(content) and bytes(content[at + 4:at + 8]) != b"IEND":
        length = int.from_bytes(content[at:at + 4], "big")
        at += length + 12  # with length, kind and check sum
        if at > len(content):
            return length
    return None
