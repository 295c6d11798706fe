# SPDX-License-Identifier: Apache-2.0
"""SE(3), projection and rectification in numpy; `T_a_b` maps points of b into a (REP-103)."""

from stack_counter.geometry.pinhole import (
    check_intrinsics,
    crop,
    rectify,
)
from stack_counter.geometry.poses import (
    apply,
    canonical_pose,
    interpolate_pose,
    inverse,
    look_at,
    nearest_point_to_rays,
    pose,
    pose_change,
    pose_from_quaternion,
    quaternion_from_pose,
)
from stack_counter.geometry.projection import (
    ProjectedPoints,
    pixel_rays,
    project,
    project_into,
    stride_for,
    unproject,
    world_points,
)

__all__ = [
    "ProjectedPoints",
    "apply",
    "canonical_pose",
    "check_intrinsics",
    "crop",
    "interpolate_pose",
    "inverse",
    "look_at",
    "nearest_point_to_rays",
    "pixel_rays",
    "pose",
    "pose_change",
    "pose_from_quaternion",
    "project",
    "project_into",
    "quaternion_from_pose",
    "rectify",
    "stride_for",
    "unproject",
    "world_points",
]
