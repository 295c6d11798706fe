# SPDX-License-Identifier: Apache-2.0
"""Depth as compressed_depth_image_transport packs it, written from its description."""

import struct

import cv2
import numpy as np
from kits.recording_kit import COMPRESSED, header, make


def rvl(depth):
    """The bytes of an (h, w) uint16 image in RVL, number by number."""
    numbers, values, i, previous = [], depth.ravel().tolist(), 0, 0
    while i < len(values):
        start = i
        while i < len(values) and values[i] == 0:
            i += 1
        numbers.append(i - start)
        start = i
        while i < len(values) and values[i] != 0:
            i += 1
        numbers.append(i - start)
        for value in values[start:i]:
            change = value - previous
            numbers.append(2 * change if change >= 0 else -2 * change - 1)
            previous = value
    digits = []
    for number in numbers:
        octal = oct(number)[2:][::-1]
        digits += [int(digit) + 8 for digit in octal[:-1]] + [int(octal[-1])]
    digits += [0] * (-len(digits) % 8)
    words = [int("".join(f"{digit:x}" for digit in digits[k:k + 8]), 16)
             for k in range(0, len(digits), 8)]
    height, width = depth.shape
    return struct.pack(f"<II{len(words)}I", width, height, *words)


def png(depth):
    """The bytes of an image as a PNG file."""
    return cv2.imencode(".png", depth)[1].tobytes()


def packed(data, name, stamp_ns=0, parameters=(0.0, 0.0), config=True, **frame):
    """A `CompressedImage`; `config`: behind the 12 bytes of compressedDepth."""
    start = struct.pack("<i2f", 0, *parameters) if config else b""
    return make(COMPRESSED, header=header(stamp_ns, **frame), format=name,
                data=np.frombuffer(start + data, np.uint8))


def inverse(metres, farthest=10.0, steps=100.0):
    """uint16 inverse depth of (h, w) metres, and its two parameters."""
    a = steps * (steps + 1)
    b = 1 - a / farthest
    with np.errstate(divide="ignore", invalid="ignore"):
        quantised = a / metres + b
    return np.where(metres < farthest, quantised, 0).astype(np.uint16), (a, b)
