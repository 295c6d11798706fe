# SPDX-License-Identifier: Apache-2.0
"""How far apart two views show one scene: a quick look at all that both see.

It tells whether registration is needed, and whether it has helped; it does not replace it: from
far off it falls short of the whole shift.

Source: Chen and Medioni, "Object modelling by registration of multiple range images" (1992), for
the distance from a point to the other view's plane; Holland and Welsch, "Robust regression using
iteratively reweighted least-squares" (1977).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.pose_graph import transform_about
from stack_counter.fusion.region import Region
from stack_counter.fusion.registration import pair_views
from stack_counter.types import View


@dataclass(frozen=True)
class ShiftSettings:
    """How the shift between two views is estimated; chosen on training scenes.

    Attributes:
        stride: pixels from one point of a surface to the next.
        max_points: largest number of points of one view that are held against the other, about.
        max_pairs: largest number of pairs of successive views that are compared; of more, views in
            between are left out, so that what moves lies between two pairs whatever their number.
        gate_m: largest distance of two points that are taken for the same, m.
        kernel_m: distance from a plane at which a point's weight is one half, m.
        kernel_noise: the same in standard deviations of a depth point; the larger holds.
        points_per_fact: number of neighbouring points that say the same.
        turn_std: turn that is expected where the points do not say, rad.
        shift_std: shift that is expected where the points do not say, m.
        rounds: number of least-squares problems.
        min_normal_cosine: least cosine between the normals of two points that may be the same.
        min_points: least number of points that two views share.
        of_second_largest: share of the second largest shift of all pairs that counts as much as
            the median. What moves between two views lies between two pairs of the ring: 7 mm
            where others have 1 to 2.6 on `bags/demo`; chosen.
    """

    stride: int = 4
    max_points: int = 5000
    max_pairs: int = 12
    gate_m: float = 0.03
    kernel_m: float = 0.003
    kernel_noise: float = 2.0
    points_per_fact: float = 10.0
    turn_std: float = 0.02
    shift_std: float = 0.01
    rounds: int = 3
    min_normal_cosine: float = 0.5
    min_points: int = 50
    of_second_largest: float = 0.4


SETTINGS = ShiftSettings()


@dataclass(frozen=True)
class Agreement:
    """How far apart successive views show the middle of a region; 0 where that is not known.

    Attributes:
        median_m: median of the shifts between them, m.
        some_m: that, or `of_second_largest` of the second largest shift where this is more, m:
            a view or a group of views may lie far from the others.
    """

    median_m: float = 0.0
    some_m: float = 0.0


def measure_agreement(views: list[View], region: Region) -> Agreement:
    """Measures how far apart successive views show the middle of a region.

    Args:
        views: with depth.
        region: where the stack is, with the noise of single depth points.
    """
    some = views[::max(1, -(-len(views) // SETTINGS.max_pairs))]
    shifts = [measure_shift(some[first], some[second], region)
              for first, second in pair_views(len(some), 1)]
    known = sorted(shift for shift in shifts if shift is not None)
    if not known:
        return Agreement()
    median = float(np.median(known))
    return Agreement(median, max(median, SETTINGS.of_second_largest * known[-2:][0]))


def measure_shift(first: View, second: View, region: Region) -> float | None:
    """How far apart two views show the middle of a region, m; None if they share too little.

    Args:
        first, second: with depth.
        region: where the stack is, with the noise of single depth points.
    """
    s = SETTINGS
    # The first view's surface, and the second one's points.
    surface = geometry.world_points(first, s.stride).astype(float)
    if min(surface.shape[:2]) < 2:
        return None
    other = geometry.world_points(second, s.stride).astype(float)
    if min(other.shape[:2]) < 2:
        return None
    normals = _normals(surface)
    inside = region.contains(other)
    points, point_normals = other[inside], _normals(other)[inside]
    every = len(points) // s.max_points + 1
    points, point_normals = points[::every], point_normals[::every]
    pivot = np.append((region.low + region.high)[:2] / 2, region.plane_z)
    kernel = max(s.kernel_m, s.kernel_noise * region.noise)
    motion = np.zeros(6)
    for _ in range(s.rounds):
        # Project the moved points on that surface.
        moved = geometry.apply(transform_about(motion, pivot), points)
        pixels = geometry.project_into(first, moved)
        rows, cols = (np.minimum((index + s.stride // 2) // s.stride, size - 1)
                      for index, size in zip((pixels.rows, pixels.cols), surface.shape))
        moved, normal = moved[pixels.inside], normals[rows, cols]
        # The two faces of a thin wall are not the same surface.
        alike = np.sum(normal * point_normals[pixels.inside], axis=1) > s.min_normal_cosine
        difference = surface[rows, cols] - moved
        distances = np.sum(normal * difference, axis=1)
        near = alike & np.isfinite(distances) & (np.linalg.norm(difference, axis=1) < s.gate_m)
        if np.count_nonzero(near) < s.min_points:
            return None
        motion = motion + _motion_step(moved[near] - pivot, normal[near], distances[near], kernel,
                                       motion)
    return float(np.linalg.norm(motion[3:]))


def _normals(surface: np.ndarray) -> np.ndarray:
    """(h, w, 3) unit normals of a grid of world points; NaN beside what was not measured."""
    normals = np.cross(np.gradient(surface, axis=1), np.gradient(surface, axis=0))
    return normals / np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)


def _motion_step(points: np.ndarray, normals: np.ndarray, distances: np.ndarray, kernel: float,
                 motion: np.ndarray) -> np.ndarray:
    """Returns the (6,) turn and shift that bring points onto their planes, by weighted squares.

    Args:
        points: (n, 3) m, about the pivot.
        normals: (n, 3) of the planes.
        distances: (n,) of the points from them, m.
        kernel: distance at which a point's weight is one half, m.
        motion: (6,) so far; what the points do not say is expected to be 0 in all.
    """
    prior = np.repeat([SETTINGS.turn_std, SETTINGS.shift_std], 3)**-2.0
    design = np.concatenate([np.cross(points, normals), normals], axis=1)
    weights = 1 / (1 + (distances / kernel)**2) / (kernel**2 * SETTINGS.points_per_fact)
    information = (design * weights[:, None]).T @ design + np.diag(prior)
    return np.linalg.solve(information, (design * weights[:, None]).T @ distances - prior * motion)
