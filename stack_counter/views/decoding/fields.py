# SPDX-License-Identifier: Apache-2.0
"""Stamps, calibrations and poses of ROS messages."""

from __future__ import annotations

from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.types import Intrinsics


def stamp_ns(stamp: Any) -> int:
    """Returns the nanoseconds of a `builtin_interfaces/Time`."""
    return int(stamp.sec) * 10**9 + int(stamp.nanosec)


def intrinsics_of_camera_info(message: Any, rectified: bool = False) -> Intrinsics:
    """Returns the calibration of the images that come with a `CameraInfo`, unchecked.

    Its K is that of the full sensor; a region of interest (`roi`) and binning are applied to it as
    image_geometry does. Field names in both ROS spellings (k, K).

    Args:
        message: the `CameraInfo`.
        rectified: the images are, so that its P holds, without distortion; of a driver that
            leaves P empty, K and distortion. Where nothing distorts there is nothing to
            rectify, and K holds whatever P says, as image_proc passes such images on. P also
            holds where a driver fills in nothing else, neither K nor distortion.
    """
    k = [float(x) for x in (message.k if hasattr(message, "k") else message.K)]
    d = message.d if hasattr(message, "d") else message.D
    model = str(message.distortion_model)
    if (rectified if any(d) else not any(k)) and (p := np.reshape(
            message.p if hasattr(message, "p") else message.P, (3, 4)).astype(float))[0, 0] > 0:
        k, d, model = p[:, :3].ravel().tolist(), (), ""
    width, height = int(message.width), int(message.height)
    left = top = 0
    if roi := getattr(message, "roi", None):
        left, top = int(roi.x_offset), int(roi.y_offset)
        width, height = int(roi.width) or width, int(roi.height) or height
    bin_x = max(int(getattr(message, "binning_x", 1)), 1)
    bin_y = max(int(getattr(message, "binning_y", 1)), 1)
    return Intrinsics(width // bin_x, height // bin_y, k[0] / bin_x, k[4] / bin_y,
                      (k[2] - left) / bin_x, (k[5] - top) / bin_y,
                      model, tuple(float(x) for x in d))


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
