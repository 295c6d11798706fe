# SPDX-License-Identifier: Apache-2.0
"""ROS messages to numpy, by attribute names alone: for rclpy's messages and for decoded bags.

Both spell fields alike (`header.stamp.sec`, `data` ...), so one set of functions serves both and
the core needs no ROS.
"""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.types import (
    BACKGROUND,
    CONTAINER,
    PARTS,
    UNLABELLED,
    UNSEEN,
    Intrinsics,
)

_ENCODINGS = {"rgb8": (np.uint8, 3), "bgr8": (np.uint8, 3), "rgba8": (np.uint8, 4),
              "bgra8": (np.uint8, 4), "mono8": (np.uint8, 1), "8UC1": (np.uint8, 1),
              "mono16": (np.uint16, 1), "16UC1": (np.uint16, 1), "32FC1": (np.float32, 1)}
_TO_RGB = {"bgr8": cv2.COLOR_BGR2RGB, "rgba8": cv2.COLOR_RGBA2RGB, "bgra8": cv2.COLOR_BGRA2RGB,
           "mono8": cv2.COLOR_GRAY2RGB, "8UC1": cv2.COLOR_GRAY2RGB}
_LABELS = (BACKGROUND, CONTAINER, PARTS, UNLABELLED, UNSEEN)
# A larger image, in pixels, is a damaged message, not a camera.
_MAX_SIDE_PX = 16384


def stamp_ns(stamp: Any) -> int:
    """Returns the nanoseconds of a `builtin_interfaces/Time`."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def image_to_array(message: Any) -> np.ndarray:
    """Decodes a `sensor_msgs/Image` to (h, w) or (h, w, channels) in the encoding's dtype.

    Raises:
        ViewError: the encoding is unknown (`bad_encoding`), or size and bytes do not fit
            (`bad_image`).
    """
    if message.encoding not in _ENCODINGS:
        raise ViewError("bad_encoding", f"encoding '{message.encoding}'; expected one of "
                                        f"{sorted(_ENCODINGS)}")
    dtype, channels = _ENCODINGS[message.encoding]
    kind = np.dtype(dtype).newbyteorder(">" if message.is_bigendian else "<")
    height, width, step = int(message.height), int(message.width), int(message.step)
    data = np.frombuffer(message.data, np.uint8)
    row = width * channels * kind.itemsize
    if not (0 < height <= _MAX_SIDE_PX and 0 < width <= _MAX_SIDE_PX) or step < row \
            or len(data) < height * step:
        raise ViewError("bad_image", f"{width}x{height} {message.encoding} with step {step} and "
                                     f"{len(data)} bytes; expected step {row} and "
                                     f"{height * row} bytes")
    pixels = data[:height * step].reshape(height, step)[:, :row]
    pixels = np.ascontiguousarray(pixels).view(kind).astype(dtype, copy=False)
    return pixels.reshape(height, width, channels) if channels > 1 else pixels


def color_to_array(message: Any) -> np.ndarray:
    """Decodes an `Image` or a `CompressedImage` (JPEG, PNG) to (h, w, 3) uint8 RGB.

    Raises:
        ViewError: the encoding is none of colour (`bad_encoding`), or the data cannot be decoded
            (`bad_image`).
    """
    if hasattr(message, "encoding"):
        if message.encoding not in ("rgb8", *_TO_RGB):
            raise ViewError("bad_encoding", f"colour in '{message.encoding}'; expected one of "
                                            f"{['rgb8', *_TO_RGB]}")
        image = image_to_array(message)
        if message.encoding == "rgb8":
            return image
        return cv2.cvtColor(image, _TO_RGB[message.encoding])
    data = np.frombuffer(message.data, np.uint8)
    # The calibration is that of the pixels as stored: an EXIF orientation does not count.
    how = cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION
    decoded = cv2.imdecode(data, how) if len(data) else None
    if decoded is None:
        raise ViewError("bad_image", f"{len(data)} bytes of '{message.format}' do not decode; "
                                     "expected a JPEG or PNG image")
    return cv2.cvtColor(decoded, cv2.COLOR_BGR2RGB)


def depth_to_metres(message: Any) -> np.ndarray:
    """Decodes a `16UC1` (mm) or `32FC1` (m) image to (h, w) float32 metres, 0 where invalid.

    Source: REP-118.

    Raises:
        ViewError: the encoding is none of depth (`bad_encoding`), size and bytes do not fit
            (`bad_image`), or no pixel is valid (`empty_depth`).
    """
    if message.encoding not in ("16UC1", "mono16", "32FC1"):
        raise ViewError("bad_encoding", f"depth in '{message.encoding}'; expected 16UC1 (mm) or "
                                        "32FC1 (m)")
    image = image_to_array(message)
    if message.encoding == "32FC1":
        depth = np.where(np.isfinite(image) & (image > 0), image, 0).astype(np.float32)
    else:
        depth = image.astype(np.float32) * np.float32(0.001)
    if not depth.any():
        raise ViewError("empty_depth", f"{depth.size} depth pixels, all invalid; expected some")
    return depth


def labels_to_array(message: Any) -> np.ndarray:
    """Decodes a `mono8` image to an (h, w) uint8 label image, whose values `View` lists.

    Raises:
        ViewError: the encoding is none of labels (`bad_encoding`), size and bytes do not fit
            (`bad_image`), or a value is none of a label
            (`bad_labels`).
    """
    if message.encoding not in ("mono8", "8UC1"):
        raise ViewError("bad_encoding", f"labels in '{message.encoding}'; expected mono8")
    labels = image_to_array(message)
    if not np.isin(labels, _LABELS).all():
        raise ViewError("bad_labels", f"label values {np.unique(labels)[:8].tolist()}; expected "
                                      "0 background, 1 container, 2 parts, 254 masked out")
    return labels


def intrinsics_of_camera_info(message: Any) -> Intrinsics:
    """Returns the calibration of the images that come with a `CameraInfo`, unchecked.

    Its K is that of the full sensor; a region of interest (`roi`) and binning are applied to it as
    image_geometry does. Field names in both ROS spellings (k, K).
    """
    k = [float(x) for x in (message.k if hasattr(message, "k") else message.K)]
    d = message.d if hasattr(message, "d") else message.D
    width, height = int(message.width), int(message.height)
    left = top = 0
    if roi := getattr(message, "roi", None):
        left, top = int(roi.x_offset), int(roi.y_offset)
        width, height = int(roi.width) or width, int(roi.height) or height
    bin_x = max(int(getattr(message, "binning_x", 1)), 1)
    bin_y = max(int(getattr(message, "binning_y", 1)), 1)
    return Intrinsics(width // bin_x, height // bin_y, k[0] / bin_x, k[4] / bin_y,
                      (k[2] - left) / bin_x, (k[5] - top) / bin_y,
                      str(message.distortion_model), tuple(float(x) for x in d))


def pose_to_matrix(pose: Any) -> np.ndarray:
    """Returns the (4, 4) transform of a `geometry_msgs/Pose`.

    Raises:
        ViewError: reason `bad_pose`: not finite, or the quaternion's norm is off 1.
    """
    q, p = pose.orientation, pose.position
    return geometry.pose_from_quaternion(np.array([q.x, q.y, q.z, q.w]),
                                         np.array([p.x, p.y, p.z]))


def transform_to_matrix(transform: Any) -> np.ndarray:
    """Returns the (4, 4) transform of a `geometry_msgs/Transform`.

    Raises:
        ViewError: reason `bad_pose`: not finite, or the quaternion's norm is off 1.
    """
    q, t = transform.rotation, transform.translation
    return geometry.pose_from_quaternion(np.array([q.x, q.y, q.z, q.w]),
                                         np.array([t.x, t.y, t.z]))
