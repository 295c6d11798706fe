# SPDX-License-Identifier: Apache-2.0
"""Corrects a view's pose by the support plane that its own depth shows.

Robots and hand-eye calibrations report poses that are off by millimetres and tenths of a degree.
All views see the same level plane around the container: height, roll and pitch of each are
corrected by it. Place and yaw in the plane stay as reported.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import SETTINGS as REGION_SETTINGS
from stack_counter.fusion.region import Region
from stack_counter.types import View


@dataclass(frozen=True)
class LevelingSettings:
    """Where the support plane is looked for, and which fit of it is used; all values are chosen.

    Attributes:
        stride: pixels from one point that is used to the next.
        reach: distance from its expected height within which the plane is looked for, m.
        common_reach: the same for views that were brought together, m.
        margin_share: width of the strip along the region's border that shows the plane alone,
            over the region's margin.
        beyond_region: distance from a configured region up to which its support shows, m.
        level: step of the histogram of heights beyond such a region, m.
        level_reach: distance from its peak of the points that are used, m.
        max_tilt: largest tilt that a pose may have wrong, rad.
        min_points: least number of points of the plane.
        min_spread: least standard deviation of their places along the shorter axis, m.
        rounds: number of fits, each without the outliers of the last one.
        outlier_factor: distance from the last fit, in standard deviations, of an outlier.
        min_outlier_distance: the same, m, for depth with little noise.
    """

    stride: int = 3
    reach: float = 0.012
    common_reach: float = 0.02
    margin_share: float = 0.85
    beyond_region: float = 0.15
    level: float = 0.001
    level_reach: float = 0.003
    max_tilt: float = 0.02
    min_points: int = 150
    min_spread: float = 0.03
    rounds: int = 4
    outlier_factor: float = 2.5
    min_outlier_distance: float = 0.001


SETTINGS = LevelingSettings()


@dataclass(frozen=True, eq=False)
class _Plane:
    """z = height + slope . (xy - center), metres.

    Attributes:
        center: (2,) mean place of the points that it was fitted to.
        height: metres, at the center.
        slope: (2,) rise for each metre along x and y.
    """

    center: np.ndarray
    height: float
    slope: np.ndarray


def level_to_support(view: View, region: Region) -> View:
    """Corrects a view's pose so that the support plane is level and at its height.

    Args:
        view: with depth.
        region: with the plane's height.

    Returns:
        The view itself where too little of the plane shows, or the plane lies too far off.
    """
    plane = _fit_plane(_points_beside_stack(view, region))
    if plane is None or np.linalg.norm(plane.slope) > SETTINGS.max_tilt \
            or abs(plane.height - region.plane_z) > SETTINGS.reach / 2:
        return view
    # Rotate the plane's normal upwards about its center; move that to the plane's height.
    slope = plane.slope
    normal = np.array([-slope[0], -slope[1], 1.0]) / np.sqrt(1 + slope @ slope)
    rotation = _smallest_rotation(normal, np.array([0, 0, 1.0]))
    pivot = np.append(plane.center, plane.height)
    shift = np.append(plane.center, region.plane_z) - rotation @ pivot
    return replace(view, T_world_camera=geometry.pose(rotation, shift) @ view.T_world_camera)


def lift_to_support(views: list[View], region: Region) -> list[View]:
    """Shifts all views alike so that the support plane is at its height.

    Args:
        views: with depth, whose surfaces lie on each other.
        region: with the plane's height.

    Returns:
        The same views; unchanged where too little of the plane shows.
    """
    beside = np.concatenate([_points_beside_stack(view, region, SETTINGS.common_reach)
                             for view in views])
    if len(beside) < SETTINGS.min_points:
        return views
    shift = np.array([0, 0, region.plane_z - np.median(beside[:, 2])])
    lift = geometry.pose(np.eye(3), shift)
    return [replace(view, T_world_camera=lift @ view.T_world_camera) for view in views]


def _points_beside_stack(view: View, region: Region, reach: float = SETTINGS.reach) -> np.ndarray:
    """(n, 3) float64 world points near the support's height: along the region's border.

    A configured region may cut through anything, so that its support is looked for beyond it.
    """
    s = SETTINGS
    points = geometry.world_points(view, s.stride).reshape(-1, 3).astype(float)
    xy = points[:, :2]
    beyond = np.maximum(region.low[:2] - xy, xy - region.high[:2]).max(axis=1)
    # Around what stands there alone: a bin's own floor is level too, and higher.
    if region.configured:
        around = (beyond > 0) & (beyond < s.beyond_region)
    else:
        around = (beyond < 0) & (beyond > -s.margin_share * REGION_SETTINGS.margin)
    points = points[around & (np.abs(points[:, 2] - region.plane_z) < reach)]
    if not region.configured or not len(points):
        return points
    # The most frequent level of them: floors of other bins are level too.
    levels = np.floor(points[:, 2] / s.level).astype(int)
    votes = np.convolve(np.bincount(levels - levels.min()), np.ones(3), mode="same")
    middle = (np.argmax(votes) + levels.min() + 0.5) * s.level
    return points[np.abs(points[:, 2] - middle) < max(s.level_reach, 3 * region.noise)]


def _fit_plane(points: np.ndarray) -> _Plane | None:
    """Plane through (n, 3) points by repeated least squares; None for too few of them."""
    s, plane, reach = SETTINGS, None, SETTINGS.reach
    for _ in range(s.rounds):
        # Enough points, spread over both axes.
        if len(points) < s.min_points:
            return None
        center = points[:, :2].mean(axis=0)
        design = np.column_stack([np.ones(len(points)), points[:, :2] - center])
        if np.linalg.eigvalsh(np.cov(design[:, 1:].T))[0] < s.min_spread**2:
            return None
        # Least squares; then drop the outliers.
        solution = np.linalg.lstsq(design, points[:, 2], rcond=None)[0]
        plane = _Plane(center, solution[0], solution[1:])
        residuals = points[:, 2] - design @ solution
        # The lower half: what stands on the plane reaches into it from above only.
        below = residuals[residuals < 0]
        std = float(np.sqrt(np.mean(below**2))) if len(below) else 0.0
        reach = min(reach, max(s.outlier_factor * std, s.min_outlier_distance))
        points = points[np.abs(residuals) < reach]
    return plane


def _smallest_rotation(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """(3, 3) the smallest rotation that takes unit vector a to b."""
    v = np.cross(a, b)
    x = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + x + x @ x / (1 + a @ b)
