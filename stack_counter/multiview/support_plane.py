# SPDX-License-Identifier: Apache-2.0
"""Which way is up, where the world does not say: along the normal of the support plane.

The plane is fitted to the background around the stack.

Source: Fischler and Bolles, "Random Sample Consensus" (1981).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, View


@dataclass(frozen=True)
class SupportPlaneSettings:
    """How the support plane is found; all chosen.

    Attributes:
        min_points: least number of background points with depth.
        max_points: largest number of them that the plane is fitted to.
        draws: number of planes through three points that are tried.
        half_thickness_m: distance up to which a point lies on a plane, m.
        min_share: least share of the background's points on the support.
        max_tilt: angle up to which the world's own z counts as up, rad, as in a robot's cell.
    """

    min_points: int = 100
    max_points: int = 40_000
    draws: int = 300
    half_thickness_m: float = 0.004
    min_share: float = 0.4
    max_tilt: float = float(np.deg2rad(3.0))


SETTINGS = SupportPlaneSettings()


class UprightWorld(NamedTuple):
    """A world whose z is the support's normal.

    Attributes:
        T_upright_world: (4, 4) rotation from the views' world into it.
        plane_z: height of the support in it, metres.
    """

    T_upright_world: np.ndarray
    plane_z: float


class _Plane(NamedTuple):
    """A point (3,) and the unit normal (3,) of a plane; share of the points that lie on it."""

    origin: np.ndarray
    normal: np.ndarray
    share: float


def find_upright(views: list[View]) -> UprightWorld:
    """Finds the support, the plane with most of the background around the stack.

    Args:
        views: with depth on some background, and labels.

    Returns:
        The world turned so that the support is level; not turned where it is nearly so.

    Raises:
        ScanError: too little background has depth, or no plane holds most of it.
        ViewError: reason `no_depth` or `no_labels`, if a view lacks them.
    """
    # Fit a plane to the background.
    points = np.concatenate([_background_points(view) for view in views])
    if len(points) < SETTINGS.min_points:
        raise ScanError(f"{len(points)} points of background have depth; expected "
                        f"{SETTINGS.min_points} or more")
    random = np.random.default_rng(0)
    points = points[random.permutation(len(points))[:SETTINGS.max_points]]
    plane = _fit_plane(points, random)
    if plane.share < SETTINGS.min_share:
        raise ScanError(f"the best plane holds {plane.share:.0%} of the background; expected "
                        f"{SETTINGS.min_share:.0%}: no level support in sight")
    # Up is the side that the cameras are on.
    centers = np.mean([view.T_world_camera[:3, 3] for view in views], axis=0)
    up = plane.normal if (centers - plane.origin) @ plane.normal > 0 else -plane.normal
    if np.arccos(np.clip(up[2], -1, 1)) < SETTINGS.max_tilt:
        return UprightWorld(np.eye(4), float(plane.origin[2]))
    # Turn it to z; any direction across it does for x.
    x = np.array([1.0, 0, 0]) if abs(up[0]) < 0.9 else np.array([0.0, 1, 0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    T_upright_world = geometry.pose(np.stack([x, np.cross(up, x), up]), np.zeros(3))
    return UprightWorld(T_upright_world, float(plane.origin @ up))


def fill_support_depth(view: View, plane_z: float) -> View:
    """Returns the view with the support's depth at every background pixel whose ray meets it.

    Labels know the stack's edge better than stereo does: what is background hides nothing of it.

    Args:
        view: with depth and labels; z of the world is up.
        plane_z: height of the support, metres, world.

    Raises:
        ViewError: reason `no_depth` or `no_labels`, if the view lacks them.
    """
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    # Intersect the rays of background pixels with the plane.
    rays = geometry.pixel_rays(view.intrinsics)
    down = -(rays @ view.T_world_camera[2, :3].astype(np.float32))
    meets = (require_labels(view) == BACKGROUND) & (down > 0)
    height = view.T_world_camera[2, 3] - plane_z
    depth = np.where(meets, height / np.where(meets, down, 1), view.depth)
    return replace(view, depth=np.maximum(depth, 0).astype(np.float32))


def _background_points(view: View) -> np.ndarray:
    """Returns (n, 3) float64 world points of the background, metres."""
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    rows, cols = np.nonzero((require_labels(view) == BACKGROUND) & (view.depth > 0))
    local = geometry.unproject(view.depth, view.intrinsics)[rows, cols].astype(float)
    return geometry.apply(view.T_world_camera, local)


def _fit_plane(points: np.ndarray, random: np.random.Generator) -> _Plane:
    """Returns the plane with the most of (n, 3) points, metres, by RANSAC."""
    # Draw planes through three points and keep the one with the most others.
    best, votes = (points[0], np.array([0.0, 0, 1])), -1
    for _ in range(SETTINGS.draws):
        a, b, c = points[random.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        normal /= max(np.linalg.norm(normal), 1e-12)
        count = int(np.count_nonzero(np.abs((points - a) @ normal) < SETTINGS.half_thickness_m))
        if count > votes:
            best, votes = (a, normal), count
    # Refit it to the points on it.
    origin, normal = best
    for _ in range(3):
        near = points[np.abs((points - origin) @ normal) < SETTINGS.half_thickness_m]
        origin = near.mean(axis=0)
        normal = np.linalg.eigh(np.cov((near - origin).T))[1][:, 0]
    share = float((np.abs((points - origin) @ normal) < SETTINGS.half_thickness_m).mean())
    return _Plane(origin, normal, share)
