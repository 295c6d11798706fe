# SPDX-License-Identifier: Apache-2.0
"""ROS messages to numpy, by attribute names alone: for rclpy's messages and for decoded bags.

Both spell fields alike (`header.stamp.sec`, `data` ...), so one set of functions serves both and
the core needs no ROS.
"""

from stack_counter.views.decoding.color import assumed_channels, color_to_array
from stack_counter.views.decoding.depth import depth_to_metres
from stack_counter.views.decoding.fields import (
    intrinsics_of_camera_info,
    pose_to_matrix,
    stamp_ns,
    transform_to_matrix,
)
from stack_counter.views.decoding.pixels import image_to_array, labels_to_array

__all__ = ["assumed_channels", "color_to_array", "depth_to_metres", "image_to_array",
           "intrinsics_of_camera_info", "labels_to_array", "pose_to_matrix", "stamp_ns",
           "transform_to_matrix"]
