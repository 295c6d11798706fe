# SPDX-License-Identifier: Apache-2.0
"""Recordings of a colour camera and a depth camera beside it, each with frame and calibration."""

from dataclasses import replace
from functools import lru_cache

import numpy as np
from kits.analytic import Scene
from kits.recording_kit import (
    CAMERA_INFO,
    DEPTH,
    FRAME,
    IMAGE,
    camera_info,
    image,
    records,
    texture,
    tf_record,
)

from stack_counter import geometry
from stack_counter.types import Intrinsics

DEPTH_FRAME = "camera_depth_optical_frame"
OWN_DEPTH, OWN_INFO = "/camera/depth/image_rect_raw", "/camera/depth/camera_info"
COLOR_CAMERA = Intrinsics(320, 240, 305.0, 305.0, 159.5, 119.5)
SAME_SIZE = Intrinsics(320, 240, 200.0, 200.0, 160.0, 120.0)
OTHER_SIZE = Intrinsics(424, 240, 214.0, 214.0, 211.0, 119.0)
T_COLOR_DEPTH = geometry.pose(np.eye(3), np.array([0.015, 0.001, -0.002]))
INNER, FILL = (0.18, 0.14, 0.10), 0.06


@lru_cache
def own_depth_scan(depth_camera=SAME_SIZE, count=6):
    """Views of a filled bin as the colour camera sees it, and as the depth camera does."""
    scene = Scene().bin(INNER, 0.004, 0.004, FILL)
    views = scene.views(count, tilts=(10, 35), radius=0.4, camera=COLOR_CAMERA)
    views = [scene.view(v.T_world_camera, COLOR_CAMERA, v.stamp_ns + 10**9) for v in views]
    return views, [scene.view(v.T_world_camera @ T_COLOR_DEPTH, depth_camera, v.stamp_ns)
                   for v in views]


def own_depth_records(depth_camera=SAME_SIZE, count=6, frame=DEPTH_FRAME, info=True, tf=True):
    """What both cameras and an arm say, as (stamp_ns, topic, kind, message).

    Args:
        depth_camera: calibration of the depth camera.
        count: number of views.
        frame: that the depth images name.
        info: whether the depth camera publishes its calibration.
        tf: whether /tf_static says where it is.
    """
    views, depths = own_depth_scan(depth_camera, count)
    views = [replace(v, color=texture(COLOR_CAMERA, i), camera=FRAME) for i, v in enumerate(views)]
    out = [r for r in records(views) if r[1] != DEPTH]
    for view in depths:
        millimetres = np.round(view.depth * 1000).astype(np.uint16)
        out.append((view.stamp_ns, OWN_DEPTH, IMAGE,
                    image(millimetres, "16UC1", view.stamp_ns, frame)))
        if info:
            out.append((view.stamp_ns + 1000, OWN_INFO, CAMERA_INFO,
                        camera_info(depth_camera, view.stamp_ns, frame)))
    if tf:
        out.append(tf_record(1, T_COLOR_DEPTH, DEPTH_FRAME, FRAME, "/tf_static"))
    return out
