# SPDX-License-Identifier: Apache-2.0
"""Brings depth views together whose poses are off by millimetres, as after a hand-eye calibration.

Each view is registered to the next ones by generalised ICP, coarse to fine, and after each level
a pose graph spreads what the pairs say over all views, with the reported poses as prior.

GICP knows planes but not their sides: the outside of a thin wall in one view is drawn to the
inside that the next view sees, and the views creep apart all around the bin. So every steep
surface is first moved a little towards its camera: the two sides of a wall are then too far
apart to be taken for each other, and what is one surface in both views stays one.

Source: Segal, Haehnel and Thrun, "Generalized-ICP" (2009), as the library `small_gicp` runs it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.pose_graph import (
    PairMotion,
    motion_about,
    solve_pose_graph,
    transform_about,
)
from stack_counter.fusion.region import Region
from stack_counter.types import View


@dataclass(frozen=True)
class RegistrationLevel:
    """One pass over all pairs.

    Attributes:
        leaf_m: side of the cells of which each keeps one point, m.
        gate_m: largest distance of two points that are taken for the same, m.
    """

    leaf_m: float
    gate_m: float


@dataclass(frozen=True)
class RegistrationSettings:
    """How views are registered; measured on 64 training scenes, poses off by 3 mm and 0.3 deg.

    Attributes:
        coarse: passes in a region that bad poses have blown up.
        fine: passes in the region that is found again after those.
        usual_distance_m: distance from the camera beyond which cells grow with it, m, as the
            distance between neighbouring points does.
        stride: pixels from one point that is used to the next.
        margin_m: support around the region that is used too, m: it holds height and tilt.
        next_views: number of following views, in a ring, that each view is registered to.
        normal_leaf_m: side of the cells in which normals are estimated, m.
        neighbors: number of points around one of which normal and covariance are estimated.
        steep: largest share of the vertical in the normal of a surface that is moved.
        offset_m: distance by which it is moved towards the camera, m; above half the first gate.
        usual_apart_m: how far views seem apart, m, with the standard deviations of reported poses
            that the pose graph expects; nearer together, it expects less.
        least_prior_scale: least factor of those standard deviations.
        max_iterations: of each registration.
        last_turn, last_shift_m: it ends with a step that turns, rad, and shifts, m, by less. On 22
            training scenes a tenth of these took twice as long, with the same errors of V.
    """

    coarse: tuple[RegistrationLevel, ...] = (RegistrationLevel(0.012, 0.035),)
    fine: tuple[RegistrationLevel, ...] = (RegistrationLevel(0.006, 0.015),
                                           RegistrationLevel(0.004, 0.006))
    usual_distance_m: float = 0.6
    stride: int = 4
    margin_m: float = 0.06
    next_views: int = 2
    normal_leaf_m: float = 0.004
    neighbors: int = 12
    steep: float = 0.5
    offset_m: float = 0.02
    usual_apart_m: float = 0.004
    least_prior_scale: float = 0.3
    max_iterations: int = 20
    last_turn: float = 1e-3
    last_shift_m: float = 1e-4


SETTINGS = RegistrationSettings()


def register_views(views: list[View], region: Region, levels: Sequence[RegistrationLevel],
                   apart_m: float) -> list[View]:
    """Corrects the poses of views so that their surfaces lie on each other.

    A motion that is common to all views stays: V does not depend on it.

    Args:
        views: with depth, two or more, and poses near the true ones.
        region: where the stack is.
        levels: passes, coarse to fine.
        apart_m: how far successive views seem apart, m: poses that are off by little must not be
            moved by much, whatever pairs of views say.

    Returns:
        The same views with corrected poses.
    """
    clouds = [_offset_cloud(view, region) for view in views]
    pairs = pair_views(len(views), SETTINGS.next_views)
    cameras = np.array([view.T_world_camera[:3, 3] for view in views])
    pivot = np.append((region.low + region.high)[:2] / 2, region.plane_z)
    distance = float(np.median(np.linalg.norm(cameras - pivot, axis=1)))
    scale = max(1.0, distance / SETTINGS.usual_distance_m)
    prior_scale = float(np.clip(apart_m / SETTINGS.usual_apart_m, SETTINGS.least_prior_scale, 1))
    corrections = np.zeros((len(views), 6))
    for level in levels:
        moved = [transform_about(correction, pivot) for correction in corrections]
        pairs_measured = _register_pairs(clouds, pairs, moved, pivot,
                                         replace(level, leaf_m=scale * level.leaf_m))
        corrections = solve_pose_graph(pairs_measured, cameras, pivot, prior_scale)
    return [replace(view, T_world_camera=transform_about(correction, pivot) @ view.T_world_camera)
            for view, correction in zip(views, corrections)]


def pair_views(count: int, next_views: int) -> list[tuple[int, int]]:
    """Pairs each of `count` views with the next ones in a ring; every pair is there once."""
    return sorted({(min(i, j), max(i, j)) for i in range(count)
                   for j in ((i + step) % count for step in range(1, next_views + 1)) if i != j})


def _register_pairs(clouds: list[np.ndarray], pairs: list[tuple[int, int]],
                    moved: list[np.ndarray], pivot: np.ndarray, level: RegistrationLevel
                    ) -> list[PairMotion]:
    """Registers the second cloud of each pair to the first.

    Args:
        clouds: (n, 3) float64 world points of each view as reported, m.
        pairs: indices of views; a pair of which one shows nothing gives no motion.
        moved: (4, 4) correction of each view so far.
        pivot: (3,) world point that motions are about, m.
        level: of this pass.
    """
    import small_gicp  # loaded where it is needed: most scans need it never

    prepared = [small_gicp.preprocess_points(cloud, level.leaf_m, SETTINGS.neighbors)
                if len(cloud) >= SETTINGS.neighbors else None for cloud in clouds]
    motions = []
    for first, second in pairs:
        target, source = prepared[first], prepared[second]
        if target is None or source is None:
            continue
        result = small_gicp.align(
            target[0], source[0], target[1], geometry.inverse(moved[first]) @ moved[second],
            max_correspondence_distance=level.gate_m, max_iterations=SETTINGS.max_iterations,
            rotation_epsilon=SETTINGS.last_turn, translation_epsilon=SETTINGS.last_shift_m)
        motions.append(PairMotion(first, second, motion_about(result.T_target_source, pivot)))
    return motions


def _offset_cloud(view: View, region: Region) -> np.ndarray:
    """Returns (n, 3) float64 world points of a view around the region, m, steep ones moved."""
    import small_gicp

    s = SETTINGS
    points = geometry.world_points(view, s.stride).reshape(-1, 3)
    around = replace(region, low=region.low - s.margin_m, high=region.high + s.margin_m)
    points = points[np.isfinite(points[:, 2]) & around.contains(points)].astype(float)
    if len(points) < s.neighbors:
        return points
    # Estimate normals, towards the camera.
    cloud = small_gicp.voxelgrid_sampling(points, s.normal_leaf_m)
    small_gicp.estimate_normals(cloud, None, s.neighbors)
    points, normals = cloud.points()[:, :3], cloud.normals()[:, :3]
    towards = np.sign(np.sum(normals * (view.T_world_camera[:3, 3] - points), axis=1))
    # Move the steep surfaces.
    steep = np.abs(normals[:, 2]) < s.steep
    return points + np.where(steep, s.offset_m * towards, 0)[:, None] * normals
