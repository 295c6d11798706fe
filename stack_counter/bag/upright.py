# SPDX-License-Identifier: Apache-2.0
"""Which way is up in a reconstruction: along the normal of the plane that all stands on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry


@dataclass(frozen=True)
class UprightSettings:
    """How the support plane is found among the features' places; all are chosen.

    Attributes:
        draws: number of planes through three points that are tried.
        max_points: largest number of points that they are tried on.
        half_thickness: distance up to which a point lies on a plane, median distances from the
            cameras to the points.
        max_below: largest share of the points below the support.
        min_share: least share of the points on it.
    """

    draws: int = 1000
    max_points: int = 5000
    half_thickness: float = 0.005
    max_below: float = 0.02
    min_share: float = 0.1


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


def find_upright_pose(points: np.ndarray, poses: np.ndarray) -> UprightPose:
    """Finds the lowest large plane and turns it level.

    Args:
        points: (n, 3) of the scene.
        poses: (m, 4, 4) of the cameras in the same world, optical frames.
    """
    random = np.random.default_rng(0)
    points = points[random.permutation(len(points))[:SETTINGS.max_points]]
    centers = poses[:, :3, 3]
    middle = np.median(points, axis=0)
    thickness = SETTINGS.half_thickness * float(
        np.median(np.linalg.norm(centers - middle, axis=1)))
    up, on_plane = -poses[:, :3, 1].mean(axis=0), np.zeros(len(points), bool)
    # Draw planes; the support has all cameras above it and next to nothing below.
    for _ in range(SETTINGS.draws):
        a, b, c = points[random.choice(len(points), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        normal /= max(float(np.linalg.norm(normal)), 1e-12)
        sides = (centers - a) @ normal
        normal = -normal if sides.mean() < 0 else normal
        heights = (points - a) @ normal
        on = np.abs(heights) < thickness
        if (sides * np.sign(sides.mean()) > 0).all() and on.sum() > on_plane.sum() \
                and (heights < -thickness).mean() <= SETTINGS.max_below:
            up, on_plane = normal, on
    share = float(on_plane.mean())
    if share < SETTINGS.min_share:
        up, share = -poses[:, :3, 1].mean(axis=0), 0.0
    else:
        up = _refit_normal(points[on_plane], up)
    return UprightPose(_turned(up, middle, points[on_plane] if share else points), share)


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
