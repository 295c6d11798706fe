# SPDX-License-Identifier: Apache-2.0
"""Image files that are damaged, or state what they do not hold."""

import resource
import struct
import zlib

import cv2
import numpy as np

from stack_counter.images import decode_image, find_png_chunk_beyond


def test_what_is_no_image_or_states_more_pixels_than_opencv_takes_does_not_decode():
    content = cv2.imencode(".png", np.eye(3, dtype=np.uint8))[1].tobytes()
    assert np.array_equal(decode_image(content, cv2.IMREAD_UNCHANGED), np.eye(3))
    head = b"IHDR" + struct.pack(">II", 40_000, 40_000) + content[24:29]
    huge = content[:12] + head + struct.pack(">I", zlib.crc32(head)) + content[33:]
    for other in (b"", b"none", content[:20], huge):
        assert decode_image(other, cv2.IMREAD_UNCHANGED) is None


def test_a_chunk_of_gigabytes_in_a_few_bytes_takes_no_memory():
    content = cv2.imencode(".png", np.eye(3, dtype=np.uint8))[1].tobytes()
    long = content[:33] + struct.pack(">I", 1_500_000_000) + content[37:]
    assert find_png_chunk_beyond(content) is None and find_png_chunk_beyond(b"none") is None
    assert find_png_chunk_beyond(long) == 1_500_000_000
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    assert decode_image(long, cv2.IMREAD_UNCHANGED) is None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 300_000  # kB
