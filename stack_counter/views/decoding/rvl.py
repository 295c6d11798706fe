# SPDX-License-Identifier: Apache-2.0
"""RVL: runs of invalid and of valid depth, these as differences, in numbers of variable length.

Source: A. D. Wilson, "Fast Lossless Depth Image Compression", ISS 2017. A number is cut into
threes of bits, the lowest first; each is a nibble whose top bit says that another follows.
"""

from __future__ import annotations

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.views.decoding.pixels import MAX_DEPTH_PIXELS, is_camera_size

_MAX_NIBBLES = 11  # of a number of 32 bits


def decode_rvl(data: bytes) -> np.ndarray:
    """Decodes an image as compressed_depth_image_transport writes it: width, height, RVL.

    Args:
        data: two numbers of 4 bytes, then 4-byte words with the first nibble on top.

    Returns:
        (h, w) uint16.

    Raises:
        ViewError: reason `bad_image`: the data are cut short or damaged.
    """
    words = np.frombuffer(data[:len(data) // 4 * 4], "<u4")
    width, height = words[:2].tolist() if len(words) > 1 else (0, 0)
    if not is_camera_size(width, height, MAX_DEPTH_PIXELS):
        raise ViewError("bad_image", f"RVL depth of {width}x{height} in {len(data)} bytes; "
                                     f"expected 1 to {MAX_DEPTH_PIXELS} pixels")
    numbers = _read_numbers(words[2:])
    starts = _find_runs(numbers, width * height)
    # All other numbers are differences, of the valid pixels one after the other.
    is_change = np.ones(len(numbers), bool)
    is_change[starts] = is_change[starts + 1] = False
    is_change[starts[-1] + 2 + numbers[starts[-1] + 1]:] = False  # fills the last word
    counts = np.stack([numbers[starts], numbers[starts + 1]], axis=1).ravel()
    is_valid = np.repeat(np.arange(len(counts)) % 2 == 1, counts)
    zigzag = numbers[is_change]
    image = np.zeros(width * height, np.uint16)
    image[is_valid] = np.cumsum((zigzag >> 1) ^ -(zigzag & 1)) & 0xFFFF
    return image.reshape(height, width)


def _read_numbers(words: np.ndarray) -> np.ndarray:
    """(n,) int64 numbers in (m,) uint32 words."""
    nibbles = (words[:, None] >> np.arange(28, -1, -4, dtype=np.uint32) & 15).astype(np.int8)
    nibbles = nibbles.ravel()
    ends = np.flatnonzero(nibbles < 8)
    starts = np.concatenate([[0], ends[:-1] + 1])
    if not len(ends) or (ends - starts).max() >= _MAX_NIBBLES:
        raise ViewError("bad_image", "RVL depth with a number that does not end; expected at most "
                                     "32 bits")
    numbers = (nibbles[starts] & 7).astype(np.int64)
    longer, place = np.flatnonzero(nibbles[starts] >= 8), 1
    while len(longer):
        digits = nibbles[starts[longer] + place]
        numbers[longer] |= (digits & 7).astype(np.int64) << 3 * place
        longer, place = longer[digits >= 8], place + 1
    return numbers


def _find_runs(numbers: np.ndarray, pixels: int) -> np.ndarray:
    """Finds where runs of pixels begin.

    Args:
        numbers: (n,) a count of invalid pixels, a count of valid ones and their differences,
            over and over.
        pixels: of the image.

    Returns:
        (r,) index of each run's first count.
    """
    counts = numbers.tolist()
    starts, at, done = [], 0, 0
    while done < pixels and at + 1 < len(counts):
        starts.append(at)
        done += counts[at] + counts[at + 1]
        at += 2 + counts[at + 1]
    if done != pixels or at > len(counts):
        raise ViewError("bad_image", f"RVL depth of {min(done, pixels)} pixels; expected {pixels}")
    return np.array(starts)
