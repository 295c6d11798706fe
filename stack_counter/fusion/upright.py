# SPDX-License-Identifier: Apache-2.0
"""Which way is up in a reconstruction: along the normal of the plane that all stands on."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.types import View


@dataclass(frozen=True)
class UprightSettings:
    """How the support plane is found among the features' places; all are chosen.

    Attributes:
        draws: number of planes through three points that are tried.
        draws_at_once: number of them whose points are counted at once: the heights of those stay
            in the processor's cache.
        max_points: largest number of points that they are tried on.
        half_thickness: distance up to which a point lies on a plane, median distances from the
            cameras to the points.
        max_below: largest share of the points below the support.
        min_share: least share of the points on it.
        points_per_view: number of points that each view gives, about.
        level_tilt: angle of the support up to which a scene is not turned, rad.
        refused_tilt: angle of the support up to which z counts as up, rad: views are levelled by
            1.5 degrees and counted alike, by 3 degrees nothing is found any more.
        wall_tilt: angle above which what looks like the support may be a wall, rad.
        min_down: mean downward part of the unit directions of sight by z, up to which such a
            support is believed.
        max_level_share: largest share of the points at one height, over the share on a tilted
            support, with which that is believed against the world's z.
    """

    draws: int = 1000
    draws_at_once: int = 100
    max_points: int = 5000
    half_thickness: float = 0.005
    max_below: float = 0.02
    min_share: float = 0.1
    points_per_view: int = 500
    level_tilt: float = 0.02
    refused_tilt: float = 0.035
    wall_tilt: float = 1.05
    min_down: float = 0.3
    max_level_share: float = 0.5


SETTINGS = UprightSettings()


@dataclass(frozen=True, eq=False)
class UprightPose:
    """Pose of a world in one whose z is up.

    Attributes:
        T_upright_world: (4, 4) rigid; with a support the origin lies on it, below the points.
        support_share: share of the points on the support; 0 where none was found, then up is
            the mean of what the pictures call up.
    """

    T_upright_world: np.ndarray
    support_share: float


def find_turn(views: Iterable[View]) -> np.ndarray:
    """Finds the turn that makes the support of a scene level.

    The worlds of apps and tools leave open where up is: ARKit's have y up, and COLMAP's have any
    direction up.

    Args:
        views: some of the scene's, with depth, in its world.

    Returns:
        (4, 4) T_upright_world; the identity where z is up, or no support shows.

    Raises:
        ViewError: reason `bad_intrinsics`.
    """
    views = list(views)
    points = _seen_points(views)
    return _find_turn(points, views) if len(points) >= SETTINGS.points_per_view else np.eye(4)


def require_z_up(views: list[View]) -> None:
    """Refuses views of a support that is not level in their world, by some degrees or more.

    Args:
        views: with depth, without distortion.

    Raises:
        ScanError: another direction is up.
    """
    points = _seen_points(views)
    if len(points) < SETTINGS.points_per_view:
        return
    up = _find_turn(points, views)[2, :3]
    tilt = float(np.arccos(np.clip(up[2], -1, 1)))
    if tilt < SETTINGS.refused_tilt:
        return
    # What is level shows that z is up, if not down: a slope of parts is no support.
    thickness = _thickness(points, np.array([view.T_world_camera[:3, 3] for view in views]))
    level, share = (_share_at_one_height(heights, thickness)
                    for heights in (points[:, 2], points @ up))
    if up[2] > 0 and level > SETTINGS.max_level_share * share:
        return
    raise ScanError(
        f"what all stands on is tilted by {np.degrees(tilt):.0f} degrees in the world; expected "
        "z of the world to point up: set world_frame to a frame whose z does (not to the base of "
        "a robot on a wall or ceiling), or mend the poses, which are of optical frames (x right, "
        "y down, z forward)")


def _seen_points(views: list[View]) -> np.ndarray:
    """(n, 3) float64 world points of some pixels of views with depth, m."""
    points = [np.zeros((0, 3))]
    for view in views:
        assert view.depth is not None  # for the type checker
        stride = max(int(np.sqrt(view.depth.size / SETTINGS.points_per_view)), 1)
        points.append(geometry.world_points(geometry.rectify(view), stride).reshape(-1, 3))
    seen = np.concatenate(points)
    return seen[np.isfinite(seen).all(axis=1)].astype(float)


def _find_turn(points: np.ndarray, views: list[View]) -> np.ndarray:
    """The turn of `find_turn`, of (n, 3) world points of the views, m."""
    poses = np.array([view.T_world_camera for view in views])
    found = find_upright_pose(points, poses)
    tilt = float(np.arccos(np.clip(found.T_upright_world[2, 2], -1, 1)))
    down = -float(np.mean(poses[:, 2, 2]))
    believed = tilt < SETTINGS.wall_tilt or down < SETTINGS.min_down
    if not found.support_share or tilt < SETTINGS.level_tilt or not believed:
        return np.eye(4)
    return found.T_upright_world


def _thickness(points: np.ndarray, centers: np.ndarray) -> float:
    """Distance up to which one of (n, 3) points lies on a plane, seen from (m, 3) centres, m."""
    middle = np.median(points, axis=0)
    return SETTINGS.half_thickness * float(np.median(np.linalg.norm(centers - middle, axis=1)))


def _share_at_one_height(heights: np.ndarray, thickness: float) -> float:
    """Largest share of (n,) heights that lie within so much of one of them, both in metres."""
    heights = np.sort(heights)
    within = np.searchsorted(heights, heights + 2 * thickness, side="right") \
        - np.arange(len(heights))
    return float(within.max() / len(heights))


def find_upright_pose(points: np.ndarray, poses: np.ndarray) -> UprightPose:
    """Finds the lowest large plane and turns it level.

    Args:
        points: (n, 3) of the scene.
        poses: (m, 4, 4) of the cameras in the same world, optical frames.
    """
    random = np.random.default_rng(0)
    points = points[random.permutation(len(points))[:SETTINGS.max_points]]
    centers = poses[:, :3, 3]
    middle, thickness = np.median(points, axis=0), _thickness(points, centers)
    up, on_plane = -poses[:, :3, 1].mean(axis=0), np.zeros(len(points), bool)
    planes = _draw_planes(points, centers, random)
    if (best := _largest_support(planes, points, thickness)) is not None:
        up, on_plane = planes[best, :3], np.abs(_heights(planes[[best]], points)[0]) < thickness
    share = float(on_plane.mean())
    if share < SETTINGS.min_share:
        up, share = -poses[:, :3, 1].mean(axis=0), 0.0
    else:
        up = _refit_normal(points[on_plane], up)
    return UprightPose(_turned(up, middle, points[on_plane] if share else points), share)


def _draw_planes(points: np.ndarray, centers: np.ndarray, random: np.random.Generator
                 ) -> np.ndarray:
    """Draws planes through three of (n, 3) points that all (m, 3) centres lie on one side of.

    Returns:
        (k, 4) unit normals towards the centres, and heights above the origin along these, m.
    """
    a, b, c = points[random.integers(len(points), size=(3, SETTINGS.draws))]
    normals = np.cross(b - a, c - a)
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    planes = np.column_stack([normals, np.sum(normals * a, axis=1)])
    sides = _heights(planes, centers)
    signs = np.sign(sides.mean(axis=1, keepdims=True))
    return (planes * signs)[(sides * signs > 0).all(axis=1)]


def _largest_support(planes: np.ndarray, points: np.ndarray, thickness: float) -> int | None:
    """Which of (k, 4) planes has most of (n, 3) points on it and next to none below; or None."""
    best, most = None, 0
    for start in range(0, len(planes), SETTINGS.draws_at_once):
        heights = _heights(planes[start:start + SETTINGS.draws_at_once], points)
        below = np.count_nonzero(heights < -thickness, axis=1)
        on = np.count_nonzero(heights < thickness, axis=1) - below
        on[below > SETTINGS.max_below * len(points)] = 0
        if on.max() > most:
            best, most = start + int(on.argmax()), int(on.max())
    return best


def _heights(planes: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(k, n) heights of (n, 3) points above (k, 4) planes, m."""
    return planes[:, :3] @ points.T - planes[:, 3:]


def _refit_normal(points: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The normal of (n, 3) points of a plane, on the side of `up`."""
    normal = np.linalg.eigh(np.cov((points - points.mean(axis=0)).T))[1][:, 0]
    return normal if normal @ up > 0 else -normal


def _turned(up: np.ndarray, middle: np.ndarray, ground: np.ndarray) -> np.ndarray:
    """(4, 4) pose that turns `up` to z and moves the place at `ground` below `middle` to 0."""
    up = up / np.linalg.norm(up)
    x = np.eye(3)[int(np.argmin(np.abs(up)))]
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    rotation = np.stack([x, np.cross(up, x), up])
    origin = rotation @ middle
    origin[2] = float(np.median(ground @ up))
    return geometry.pose(rotation, -origin)
