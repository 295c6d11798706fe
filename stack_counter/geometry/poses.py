# SPDX-License-Identifier: Apache-2.0
"""SE(3) in numpy: poses, rays and what lies between them; `T_a_b` maps points of b into a."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.errors import ScanError, ViewError
from stack_counter.geometry import rotations


@dataclass(frozen=True)
class GeometrySettings:
    """Which inputs are refused, and how poses are rounded; all values are chosen.

    Attributes:
        quaternion_norm_error: largest distance of a quaternion's norm from 1.
        ray_condition: largest condition number of the equations for the point nearest to several
            rays; it is about 1e6 for rays within a thousandth of a radian.
        quaternion_step: step to which the ratios of a quaternion's components to the largest are
            rounded; a hundred times the rounding errors of the way to a matrix and back.
    """

    quaternion_norm_error: float = 0.01
    ray_condition: float = 1e6
    quaternion_step: float = 2.0**-44


SETTINGS = GeometrySettings()


def pose(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(4, 4) transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """Inverse of a rigid (4, 4) transform."""
    return pose(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def apply(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., 3) points mapped by a (4, 4) transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def pose_from_quaternion(quaternion: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(4, 4) transform from a quaternion (x, y, z, w) and a translation in metres.

    The rotation is rounded, by less than 1e-13 rad, to one that survives `quaternion_from_pose`
    and this function bit by bit.

    Raises:
        ViewError: reason `bad_pose`, for values that are not finite or a norm off 1 by over 1%.
    """
    q, t = np.asarray(quaternion, float), np.asarray(translation, float)
    norm_error = abs(float(np.linalg.norm(q)) - 1)
    if not (np.isfinite(q).all() and np.isfinite(t).all()
            and norm_error < SETTINGS.quaternion_norm_error):
        raise ViewError("bad_pose", f"quaternion {q.tolist()} with translation {t.tolist()}; "
                                    "expected finite numbers and a norm of 1")
    steps = np.round(q / q[np.argmax(np.abs(q))] / SETTINGS.quaternion_step)
    return pose(rotations.matrix_from_quaternion(steps * SETTINGS.quaternion_step), t)


def canonical_pose(T: np.ndarray) -> np.ndarray:
    """Returns the (4, 4) transform that every quaternion message of `T` is read back as.

    Rounding errors of a message grow: matching pictures amplifies a pose's 1e-16 to a thousandth
    of V. A view whose pose is canonical gives the same bits on either side of any message.
    """
    return pose_from_quaternion(quaternion_from_pose(T), T[:3, 3])


def quaternion_from_pose(T: np.ndarray) -> np.ndarray:
    """(4,) quaternion (x, y, z, w), w >= 0, of the rotation of a (4, 4) transform."""
    return rotations.quaternion_from_matrix(T[:3, :3])


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray = np.array([0.0, 0, 1])
            ) -> np.ndarray:
    """T_world_camera of a camera at `eye` whose optical axis (z) meets `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # straight up or down: image x along world x
        right = np.array([1.0, 0, 0])
    right = right / np.linalg.norm(right)
    return pose(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


def nearest_point_to_rays(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(3,) point with the least sum of squared distances to n straight lines, metres.

    Args:
        origins: (n, 3) a point of each line, metres.
        directions: (n, 3) unit vectors along them.

    Raises:
        ScanError: the lines are nearly parallel.
    """
    across = [np.eye(3) - np.outer(d, d) for d in directions]
    normal = np.sum(across, axis=0)
    if np.linalg.cond(normal) > SETTINGS.ray_condition:
        raise ScanError("the views look along one direction; expected views from several sides")
    return np.linalg.solve(normal, np.sum([a @ o for a, o in zip(across, origins)], axis=0))


def interpolate_pose(T_a: np.ndarray, T_b: np.ndarray, share: float) -> np.ndarray:
    """The pose at `share` (0 to 1) of the way from one to the other: slerp and a straight line."""
    rotation = rotations.interpolate_rotation(T_a[:3, :3], T_b[:3, :3], share)
    return pose(rotation, (1 - share) * T_a[:3, 3] + share * T_b[:3, 3])


def pose_change(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """The distance, metres, and the angle, radians, between two poses, (4, 4) each."""
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    return (float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])),
            float(np.arccos(np.clip(cosine, -1, 1))))
