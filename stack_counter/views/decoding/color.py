# SPDX-License-Identifier: Apache-2.0
"""Colour images of cameras to RGB: packed, planar, of a Bayer mosaic, or compressed.

Source: sensor_msgs/image_encodings.hpp and cv_bridge of ROS 2 Jazzy. OpenCV's older Bayer names
(`BayerBG`) are of the second row and column; those used here are of the first, as ROS's are.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stack_counter.errors import ViewError
from stack_counter.views.decoding.image_files import check_stated_size
from stack_counter.views.decoding.pixels import PLANAR, image_to_array

# What OpenCV calls the way from an encoding to RGB; None: it is RGB.
_TO_RGB: dict[str, int | None] = {
    "rgb": None, "bgr": cv2.COLOR_BGR2RGB, "rgba": cv2.COLOR_RGBA2RGB, "bgra": cv2.COLOR_BGRA2RGB,
    "mono": cv2.COLOR_GRAY2RGB,
    "bayer_rggb": cv2.COLOR_BayerRGGB2RGB, "bayer_bggr": cv2.COLOR_BayerBGGR2RGB,
    "bayer_gbrg": cv2.COLOR_BayerGBRG2RGB, "bayer_grbg": cv2.COLOR_BayerGRBG2RGB}
_CONVERSIONS: dict[str, int | None] = {
    **{name + bits: how for name, how in _TO_RGB.items() for bits in ("8", "16")},
    "8UC1": cv2.COLOR_GRAY2RGB, "8UC3": cv2.COLOR_BGR2RGB, "8UC4": cv2.COLOR_BGRA2RGB,
    "16UC3": cv2.COLOR_BGR2RGB, "16UC4": cv2.COLOR_BGRA2RGB,
    "yuv422": cv2.COLOR_YUV2RGB_UYVY, "uyvy": cv2.COLOR_YUV2RGB_UYVY,
    "yuv422_yuy2": cv2.COLOR_YUV2RGB_YUY2, "yuyv": cv2.COLOR_YUV2RGB_YUY2,
    "nv12": cv2.COLOR_YUV2RGB_NV12, "nv21": cv2.COLOR_YUV2RGB_NV21}
# These give colour to two pixels at once.
_OF_EVEN_WIDTH = ("yuv422", "uyvy", "yuv422_yuy2", "yuyv", *PLANAR)
# OpenCV's own types, whose names do not say the order of the channels -> how they are read.
_ASSUMED = {"8UC3": "BGR", "16UC3": "BGR", "8UC4": "BGRA", "16UC4": "BGRA"}


def color_to_array(message: Any) -> np.ndarray:
    """Decodes an `Image` or a `CompressedImage` (JPEG, PNG) to (h, w, 3) uint8 RGB.

    Of 16 bits the upper eight are kept.

    Raises:
        ViewError: the encoding is none of colour (`bad_encoding`), or the data cannot be decoded
            (`bad_image`).
    """
    if not hasattr(message, "encoding"):
        return _decompress(message)
    encoding = message.encoding
    if encoding not in _CONVERSIONS:
        raise ViewError("bad_encoding", f"colour in '{encoding}'; expected one of "
                                        f"{list(_CONVERSIONS)}: set color_topic, or the "
                                        "driver's format")
    if encoding in _OF_EVEN_WIDTH and (message.width % 2 or encoding in PLANAR
                                       and message.height % 2):
        raise ViewError("bad_image", f"{message.width}x{message.height} {encoding}; expected an "
                                     "even size")
    return _to_rgb(image_to_array(message), encoding)


def assumed_channels(message: Any) -> str:
    """Says how channels are read whose order the encoding does not name; "" if it does."""
    encoding = getattr(message, "encoding", "")
    return f"'{encoding}' does not name the order of its channels; read as {_ASSUMED[encoding]}" \
        if encoding in _ASSUMED else ""


def _to_rgb(image: np.ndarray, encoding: str) -> np.ndarray:
    """(h, w, 3) uint8 RGB of pixels in one of the encodings."""
    how = _CONVERSIONS[encoding]
    rgb = image if how is None else cv2.cvtColor(image, how)
    return (rgb >> 8).astype(np.uint8) if rgb.dtype == np.uint16 else rgb


def _decompress(message: Any) -> np.ndarray:
    """(h, w, 3) uint8 RGB of a `CompressedImage`, whose format may name a Bayer mosaic."""
    data = np.frombuffer(message.data, np.uint8)
    check_stated_size(data.data, str(message.format))
    # Before the semicolon stands the encoding of what was compressed.
    encoding = str(message.format).partition(";")[0].strip()
    # The calibration is that of the pixels as stored: an EXIF orientation does not count.
    how = cv2.IMREAD_UNCHANGED if encoding.startswith("bayer_") else cv2.IMREAD_COLOR
    decoded = cv2.imdecode(data, how | cv2.IMREAD_IGNORE_ORIENTATION)
    if decoded is None:
        raise ViewError("bad_image", f"{len(data)} bytes of '{message.format}' do not decode; "
                                     "expected a JPEG or PNG image")
    is_mosaic = decoded.ndim == 2 and encoding in _CONVERSIONS
    return _to_rgb(decoded, encoding if is_mosaic else "bgr8")
