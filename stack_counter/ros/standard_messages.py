# SPDX-License-Identifier: Apache-2.0
"""Standard ROS messages of core values: stamps, poses, images, calibrations.

The way back is `stack_counter.views.decoding`, which reads recorded bags as well and therefore
works without ROS.
"""

from __future__ import annotations

import array
import importlib

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from sensor_msgs.msg import CameraInfo, Image
from std_msgs.msg import Header

from stack_counter import geometry
from stack_counter.types import Intrinsics


def to_time(stamp_ns: int) -> Time:
    """Returns the ROS time of a stamp in ns."""
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def to_header(stamp_ns: int, frame_id: str) -> Header:
    """Returns a header with this stamp, ns, and frame."""
    return Header(stamp=to_time(stamp_ns), frame_id=frame_id)


def to_pose(transform: np.ndarray) -> Pose:
    """Returns the pose message of a (4, 4) float64 transform, metres."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = (float(x) for x in transform[:3, 3])
    (pose.orientation.x, pose.orientation.y, pose.orientation.z,
     pose.orientation.w) = (float(x) for x in geometry.quaternion_from_pose(transform))
    return pose


def to_image(image: np.ndarray | None, encoding: str, header: Header) -> Image:
    """Returns the image message of an (h, w) or (h, w, 3) array; one without data for None."""
    message = Image(header=header, encoding=encoding)
    if image is not None:
        message.height, message.width = image.shape[:2]
        message.step = image[0].nbytes
        message.data = to_bytes(image)
    return message


def to_bytes(values: np.ndarray) -> array.array:
    """Returns the bytes of an array in the type that rclpy takes without copying one by one."""
    data = array.array("B")
    data.frombytes(np.ascontiguousarray(values).data.cast("B"))
    return data


def to_camera_info(intrinsics: Intrinsics, header: Header) -> CameraInfo:
    """Returns the calibration message with K, D and the distortion model; R is the identity."""
    k = intrinsics
    info = CameraInfo(header=header, width=k.width, height=k.height,
                      distortion_model=k.distortion_model, d=list(k.distortion))
    info.k = [float(x) for x in k.K.ravel()]
    info.p = [k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return info


def message_type(name: str) -> type:
    """Returns the class of a type named as in a bag, e.g. `sensor_msgs/msg/Image`."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)
