# SPDX-License-Identifier: Apache-2.0
"""Depth images to metres: raw, PNG, and as compressed_depth_image_transport packs them.

Source: REP-118; compressed_depth_image_transport's codec.cpp. Its data begin with 12 bytes: a
number that nobody reads, and the two of the inverse depth in which 32FC1 is quantised.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stack_counter.errors import ViewError
from stack_counter.views.decoding.image_files import check_stated_size
from stack_counter.views.decoding.pixels import MAX_DEPTH_PIXELS, image_to_array
from stack_counter.views.decoding.rvl import decode_rvl

_RAW = ("16UC1", "mono16", "16SC1", "32FC1", "64FC1")
_CONFIG_BYTES = 12
_PNG = b"\x89PNG"


@dataclass(frozen=True)
class DepthUnitSettings:
    """When depth cannot be in the unit that its encoding means; chosen.

    Attributes:
        farthest_m: no depth camera has half of its pixels beyond it, metres.
        units_m: units that drivers use, metres; the first that gives a likely distance is named.
        likely_m: likely distances of a bin from a camera, metres.
        byte_order_factor: so many times as rough is depth whose bytes are in the wrong order, or
            more: a hundred times on `bags/demo`.
    """

    farthest_m: float = 100.0
    units_m: tuple[float, ...] = (0.001, 0.0001)
    likely_m: tuple[float, float] = (0.15, 3.0)
    byte_order_factor: float = 4.0


SETTINGS = DepthUnitSettings()


def depth_to_metres(message: Any, scale: float = 0.0) -> np.ndarray:
    """Decodes a depth `Image` or `CompressedImage` to (h, w) float32 metres, 0 where invalid.

    Args:
        message: 16UC1, mono16 or 16SC1 (mm), 32FC1 or 64FC1 (m); compressed: 16 bits as PNG or
            RVL, or 32FC1 as the inverse depth of compressedDepth.
        scale: metres that a unit is; 0: what the encoding means.

    Raises:
        ViewError: the encoding is none of depth (`bad_encoding`), the data cannot be decoded
            (`bad_image`), no pixel is valid (`empty_depth`), or the numbers cannot be metres as
            the encoding means them (`wrong_depth_unit`).
    """
    if not hasattr(message, "encoding"):
        image = _decompress(message)
    elif message.encoding in _RAW:
        image = _in_byte_order(image_to_array(message), message)
    else:
        raise ViewError("bad_encoding", f"depth in '{message.encoding}'; expected 16UC1 (mm) or "
                                        "32FC1 (m): set depth_topic, or the driver's format")
    is_float = np.issubdtype(image.dtype, np.floating)
    if is_float:
        with np.errstate(over="ignore"):  # of double precision: beyond single is invalid
            image = image.astype(np.float32)
    image = np.where(np.isfinite(image) & (image > 0), image, 0)
    if not image.any():
        raise ViewError("empty_depth", f"{image.size} depth pixels, all invalid; expected some: "
                                       "check the camera's range and laser, or set depth_topic")
    if is_float and not scale:
        _check_metres(image)
    return image.astype(np.float32) * np.float32(scale or (1.0 if is_float else 0.001))


def _in_byte_order(image: np.ndarray, message: Any) -> np.ndarray:
    """(h, w) depth as it is stored, where a driver says big-endian of what is not.

    In the right order neighbours differ little; in the other their lower bytes lead.
    """
    if image.dtype.itemsize != 2 or not message.is_bigendian:
        return image
    swapped = image.byteswap()
    rough, rough_swapped = (float(np.abs(np.diff(i.astype(np.int32))).mean())
                            for i in (image, swapped))
    return swapped if rough_swapped * SETTINGS.byte_order_factor < rough else image


def _check_metres(image: np.ndarray) -> None:
    """Refuses (h, w) depth, 0 where invalid, that cannot be in metres: no camera sees so far."""
    median = float(np.median(image[image > 0]))
    if median <= SETTINGS.farthest_m:
        return
    nearest, farthest = SETTINGS.likely_m
    unit = next((f": {unit:g}" for unit in SETTINGS.units_m
                 if nearest <= median * unit <= farthest), "")
    raise ViewError("wrong_depth_unit", f"half of the depth is beyond {median:.0f}, taken as "
                                        f"metres; expected some metres: set depth_scale{unit} "
                                        "(metres a unit)")


def _decompress(message: Any) -> np.ndarray:
    """Decodes a `CompressedImage` to (h, w) uint16 units, or float32 metres.

    What is packed is seen by the data: drivers spell their format in many ways.
    """
    data, name = bytes(message.data), str(message.format)
    if data[_CONFIG_BYTES:].startswith(_PNG):
        image = _decode_image(data[_CONFIG_BYTES:], name)
    elif "compressedDepth" in name and "rvl" in name:
        image = decode_rvl(data[_CONFIG_BYTES:])
    else:
        return _decode_image(data, name)
    return _from_inverse(image, data) if name.startswith("32FC1") else image


def _decode_image(data: bytes, name: str) -> np.ndarray:
    """Decodes an image file of one channel of 16 bits, or of float32."""
    check_stated_size(data, name, MAX_DEPTH_PIXELS)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise ViewError("bad_image", f"{len(data)} bytes of depth in '{name}' do not decode; "
                                     "expected a PNG image of 16 bits, or compressedDepth")
    if image.ndim != 2 or image.dtype not in (np.uint16, np.float32):
        raise ViewError("bad_encoding", f"depth in '{name}' of {image.dtype} and shape "
                                        f"{image.shape}; expected one channel of 16 bits: 8 "
                                        "bits, as of JPEG, hold no depth; record it raw, as PNG "
                                        "or by compressedDepth")
    return image


def _from_inverse(image: np.ndarray, data: bytes) -> np.ndarray:
    """(h, w) float32 metres of uint16 inverse depth, by the two parameters before the image."""
    a, b = struct.unpack_from("<4x2f", data)
    if not (np.isfinite([a, b]).all() and a > 0):
        raise ViewError("bad_image", f"quantisation of compressedDepth by {a:g} and {b:g}; "
                                     "expected finite numbers, the first above 0")
    with np.errstate(divide="ignore"):
        return np.where(image > 0, a / (image.astype(np.float32) - b), 0).astype(np.float32)
