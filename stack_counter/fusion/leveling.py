"""Takes out of a view's pose what its own picture of the support plane contradicts.

Robots and hand-eye calibrations report poses that are off by millimetres and tenths of a degree.
All views see the same level plane around the container: height, roll and pitch of each are
corrected by it. Place and yaw in the plane stay as reported.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import MARGIN, Region
from stack_counter.types import View

_STRIDE = 3  # pixels between the points looked at
_REACH = 0.012  # how far from where it should be the plane is looked for, m
_AROUND = 0.85  # of the margin that a region has around what stands in it
_STEEPEST = 0.02  # tilt that a pose may have wrong, rad
_FEWEST = 150  # points of the plane
_SPREAD = 0.03  # standard deviation of their places along the shorter axis, m
_ROUNDS = 4  # of fits, each without what lies far off the last one


def level_to_support(view: View, region: Region) -> View:
    """The view with a pose in which the support plane is level and at its height; as it was where
    too little of the plane shows, or the plane lies too far off.

    Args:
        view: with depth.
        region: with the plane's height.
    """
    points = geometry.world_points(view, _STRIDE).reshape(-1, 3).astype(float)
    xy = points[:, :2]
    beyond = np.maximum(region.low[:2] - xy, xy - region.high[:2]).max(axis=1)
    # Around what stands there alone: a bin's own floor is level too, and higher.
    around = (beyond < 0) & (beyond > -_AROUND * MARGIN)
    points = points[around & (np.abs(points[:, 2] - region.plane_z) < _REACH)]
    middle, plane = np.zeros(2), np.zeros(3)
    reach = _REACH
    for _ in range(_ROUNDS):
        if len(points) < _FEWEST:
            return view
        middle = points[:, :2].mean(axis=0)
        flat = np.column_stack([np.ones(len(points)), points[:, :2] - middle])
        if np.linalg.eigvalsh(np.cov(flat[:, 1:].T))[0] < _SPREAD**2:
            return view
        plane = np.linalg.lstsq(flat, points[:, 2], rcond=None)[0]
        miss = points[:, 2] - flat @ plane
        # The lower half: what stands on the plane reaches into it from above only.
        below = miss[miss < 0]
        reach = min(reach, max(2.5 * float(np.sqrt(np.mean(below**2))), 0.001))
        points = points[np.abs(miss) < reach]
    height, slope = plane[0], plane[1:]
    if np.linalg.norm(slope) > _STEEPEST or abs(height - region.plane_z) > _REACH / 2:
        return view
    up = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope @ slope)
    turn = _turned(up, np.array([0, 0, 1.0]))
    pivot = np.append(middle, height)
    shift = np.append(middle, region.plane_z) - turn @ pivot
    return replace(view, T_world_camera=geometry.pose(turn, shift) @ view.T_world_camera)


def _turned(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3) the smallest rotation that takes unit vector a to b."""
    v = np.cross(a, b)
    x = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + x + x @ x / (1 + a @ b)
