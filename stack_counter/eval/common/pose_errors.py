# SPDX-License-Identifier: Apache-2.0
"""How far told poses of parts are off, and whether their fit says so.

ADD-S, the mean distance from a point of the true part to the nearest of the told one, in part
diameters, knows symmetries. It forgives much of compact parts: so the same is measured of the true
part turned at random about its middle.

Source: Hinterstoisser et al., "Model Based Training, Detection and Pose Estimation" (2012).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.types import Mesh, PartPose
from stack_counter.visible_parts.part_views import make_part_views, sample_surface

# Bounds of ADD-S below which a pose is right, part diameters; share of right ones that a threshold
# of the fit is to give. The figures are defined by these.
_RIGHT, _CLOSE, _PRECISION = 0.1, 0.05, 0.9
_TRUE_POINTS, _TOLD_POINTS = 300, 8000  # the told ones lie a hundredth of a diameter apart
_NEAR = 4  # true parts that a pose may be of: those whose middles are nearest


@dataclass(frozen=True)
class PoseError:
    """How far one told pose is off.

    Attributes:
        error: ADD-S to the true part that lies nearest, part diameters.
        turned_error: that of the true part turned at random.
        fit: as told.
    """

    error: float
    turned_error: float
    fit: float


def measure_poses(poses: Sequence[PartPose | None], true: np.ndarray, mesh: Mesh
                  ) -> tuple[PoseError, ...]:
    """Measures the poses that were told.

    Args:
        poses: as told; None are left out.
        true: (n, 4, 4) T_world_part of all parts of the scene.
        mesh: of the part.
    """
    diameter, center = make_part_views(mesh).diameter, make_part_views(mesh).center
    points, told_points = (sample_surface(mesh, n) for n in (_TRUE_POINTS, _TOLD_POINTS))
    middles = true[:, :3, :3] @ center + true[:, :3, 3]
    turns = Rotation.random(len(poses), random_state=0).as_matrix()
    own_tree = KDTree(told_points)
    errors = []
    for pose, turn in zip(poses, turns):
        if pose is None:
            continue
        T = pose.T_world_part
        near = np.linalg.norm(middles - geometry.apply(T, center), axis=1).argsort()[:_NEAR]
        to_told = geometry.inverse(T)
        error = min(own_tree.query(geometry.apply(to_told @ true[i], points))[0].mean()
                    for i in near)
        turned = own_tree.query((points - center) @ turn.T + center)[0].mean()
        errors.append(PoseError(float(error) / diameter, float(turned) / diameter, pose.fit))
    return tuple(errors)


def is_right(error: PoseError) -> bool:
    """Whether a pose is right."""
    return error.error < _RIGHT


def format_poses(errors: Sequence[PoseError]) -> str:
    """The figures of all poses."""
    told, turned, fits = (np.array([getattr(e, name) for e in errors])
                          for name in ("error", "turned_error", "fit"))
    lines = [f"{len(errors)} poses, median ADD-S {np.median(told):.3f} diameters",
             f"{'ADD-S below':12}{'poses':>8}{'at random':>11}{'fit for 90%':>13}{'pass it':>9}"]
    for bound in (_RIGHT, _CLOSE):
        threshold, passing = _threshold(told < bound, fits)
        lines.append(f"{bound:<12}{np.mean(told < bound):8.3f}{np.mean(turned < bound):11.3f}"
                     f"{threshold:13.2f}{passing:9.3f}")
    return "\n".join(lines)


def _threshold(right: np.ndarray, fits: np.ndarray) -> tuple[float, float]:
    """The least fit from which nine of ten poses are right, and the share of all that have it."""
    order = np.argsort(-fits, kind="stable")
    enough = np.flatnonzero(np.cumsum(right[order]) >= _PRECISION * np.arange(1, len(order) + 1))
    if not len(enough):
        return np.nan, 0.0
    return float(fits[order[enough[-1]]]), float((enough[-1] + 1) / len(order))


def draw_silhouette(picture: np.ndarray, triangles: np.ndarray, color: tuple[int, int, int]
                    ) -> None:
    """Draws the outline of a mesh into (h, w, 3) uint8, of (m, 3, 2) int32 corners, pixels."""
    mask = np.zeros(picture.shape[:2], np.uint8)
    for corners in triangles:
        cv2.fillConvexPoly(mask, corners, 1)
    outlines, _ = cv2.findContours(mask, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_NONE)
    cv2.drawContours(picture, outlines, -1, color, 1, cv2.LINE_AA)
