# SPDX-License-Identifier: Apache-2.0
"""Pixels of a `sensor_msgs/Image` whose rows hold them one after the other, and label images.

Source: sensor_msgs/image_encodings.hpp of ROS 2 Jazzy.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, UNLABELLED, UNSEEN

_LABELS = (BACKGROUND, CONTAINER, PARTS, UNLABELLED, UNSEEN)
# Encoding -> dtype and number of channels of its pixels.
LAYOUTS: dict[str, tuple[type[np.generic], int]] = {
    "mono8": (np.uint8, 1), "mono16": (np.uint16, 1),
    "rgb8": (np.uint8, 3), "bgr8": (np.uint8, 3), "rgba8": (np.uint8, 4), "bgra8": (np.uint8, 4),
    "rgb16": (np.uint16, 3), "bgr16": (np.uint16, 3),
    "rgba16": (np.uint16, 4), "bgra16": (np.uint16, 4),
    "8UC1": (np.uint8, 1), "8UC3": (np.uint8, 3), "8UC4": (np.uint8, 4),
    "16UC1": (np.uint16, 1), "16UC3": (np.uint16, 3), "16UC4": (np.uint16, 4),
    "16SC1": (np.int16, 1), "32FC1": (np.float32, 1), "64FC1": (np.float64, 1),
    **{f"bayer_{order}{bits}": (kind, 1) for order in ("rggb", "bggr", "gbrg", "grbg")
       for bits, kind in ((8, np.uint8), (16, np.uint16))},
    "yuv422": (np.uint8, 2), "uyvy": (np.uint8, 2),
    "yuv422_yuy2": (np.uint8, 2), "yuyv": (np.uint8, 2),
    "nv12": (np.uint8, 1), "nv21": (np.uint8, 1)}
# Of these, half as many rows of colour follow the rows of brightness.
PLANAR = ("nv12", "nv21")
# A larger image, in pixels, is a damaged message, not a camera. Chosen: pictures of phones have
# 200 million, depth cameras some. Packed images of so many pixels may be a few bytes long.
MAX_SIDE_PX = 16384
MAX_PIXELS = 1 << 28
MAX_DEPTH_PIXELS = 1 << 26


def is_camera_size(width: int, height: int, most: int = MAX_PIXELS) -> bool:
    """Whether a camera may have so many pixels, `most` at most: room is made only for those."""
    return 0 < width <= MAX_SIDE_PX and 0 < height <= MAX_SIDE_PX and width * height <= most


def image_to_array(message: Any) -> np.ndarray:
    """Decodes a `sensor_msgs/Image` to (h, w) or (h, w, channels) in the encoding's dtype.

    Planar images are (h * 3 / 2, w), brightness above colour.

    Raises:
        ViewError: the encoding is unknown (`bad_encoding`), or size and bytes do not fit
            (`bad_image`).
    """
    if message.encoding not in LAYOUTS:
        raise ViewError("bad_encoding", f"encoding '{message.encoding}'; expected one of "
                                        f"{sorted(LAYOUTS)}")
    dtype, channels = LAYOUTS[message.encoding]
    kind = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    height, width = int(message.height), int(message.width)
    rows = height * 3 // 2 if message.encoding in PLANAR else height
    data = np.frombuffer(message.data, np.uint8)
    row = width * channels * kind.itemsize
    step = int(message.step) or row  # some publishers leave it at 0 where nothing is padded
    if not (0 < height <= MAX_SIDE_PX and 0 < width <= MAX_SIDE_PX) or step < row \
            or len(data) < rows * step:
        raise ViewError("bad_image", f"{width}x{height} {message.encoding} with step {step} and "
                                     f"{len(data)} bytes; expected step {row} and "
                                     f"{rows * row} bytes")
    pixels = data[:rows * step].reshape(rows, step)[:, :row]
    pixels = np.ascontiguousarray(pixels).view(kind).astype(dtype, copy=False)
    return pixels.reshape(rows, width, channels) if channels > 1 else pixels


def labels_to_array(message: Any) -> np.ndarray:
    """Decodes a `mono8` image to an (h, w) uint8 label image, whose values `View` lists.

    Raises:
        ViewError: the encoding is none of labels (`bad_encoding`), size and bytes do not fit
            (`bad_image`), or a value is none of a label (`bad_labels`).
    """
    if message.encoding not in ("mono8", "8UC1"):
        raise ViewError("bad_encoding", f"labels in '{message.encoding}'; expected mono8")
    labels = image_to_array(message)
    if not np.isin(labels, _LABELS).all():
        raise ViewError("bad_labels", f"label values {np.unique(labels)[:8].tolist()}; expected "
                                      "0 background, 1 container, 2 parts, 254 masked out")
    return labels
