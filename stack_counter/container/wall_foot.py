# SPDX-License-Identifier: Apache-2.0
"""Whether a container's wall is seen down to the underside that it is taken to have."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.container.base import SETTINGS as BASE_SETTINGS
from stack_counter.container.base import (
    cells_beside,
    find_lower_edge,
    is_beside,
    medians_by_sector,
    sectors,
)
from stack_counter.container.wall_fit import FacePoints, FittedWall
from stack_counter.fusion.region import Region
from stack_counter.types import HeightMap, View, WallShape


@dataclass(frozen=True)
class WallFootSettings:
    """When a wall is doubted to go down to the underside.

    Attributes:
        lower_stride: pixels between the points that are looked for right beside the container: a
            gap beside a deep recess shows little of it; chosen.
        min_lower_m: depth below the underside, m, of what surely lies lower: so deep lay nothing
            beside 39 containers on a plane.
        lower_noise_factor: the same in standard deviations of a depth point; chosen.
        max_recess: largest depth of a recess over the rim's height above what surrounds it: beside
            a table's edge the ground lies deeper; chosen.
        min_lower_share: least share of a direction's points right beside the wall that lie lower
            than its underside where that stands in a recess; chosen.
        min_lower_directions: least share of the directions that show such points: none did in 39
            containers on a plane, 0.11 and more in recesses around which a gap of 7 mm shows.
        max_unseen_foot: height above its underside, m, down to which a side of a box must show:
            all four showed to the underside itself in 25 of 25 training recordings of 12 views,
            and three at least in 20 of 20 hard ones of 5 or 6 views; on rails, the two that do
            not stand on them end at their height.
        min_open_share: least share of what lies right beside a side that must be the ground;
            chosen.
        min_short_sides: least number of sides that end higher for the whole to be doubted; chosen.
        profile_reach: distance from the outer face within which points show its profile, m;
            chosen.
        slice: step of the heights in which that profile is read, m; chosen.
        min_slice_points: least number of points of a slice that shows it; chosen.
        ledge: step outwards, m, by which a wall below another begins: 0.8 mm and more where a
            drafted container stood on another of its kind, at most 0.45 in 117 of the training
            sets, of 4 to 12 views.
        ledge_errors: what the depth's noise adds to that, standard errors of a slice; chosen.
    """

    lower_stride: int = 2
    min_lower_m: float = 0.004
    lower_noise_factor: float = 4.0
    max_recess: float = 2.0
    min_lower_share: float = 0.1
    min_lower_directions: float = 0.1
    max_unseen_foot: float = 0.008
    min_open_share: float = 0.5
    min_short_sides: int = 2
    profile_reach: float = 0.012
    slice: float = 0.003
    min_slice_points: int = 30
    ledge: float = 0.0006
    ledge_errors: float = 5.0


SETTINGS = WallFootSettings()


def reaches_base(top: HeightMap, views: list[View], wall: FittedWall, points: FacePoints,
                 rim_height: float, base: float, region: Region) -> bool:
    """Whether a wall is seen down to the underside that its container is taken to have.

    No wall is beside which something lower shows, as in a recess, or which is two: the lower one
    begins with a ledge, as of a container that another stands on. Only where the ground shows
    beside it are ledges and the sides of a box looked at: other things hide a wall. Other kinds
    may lean so far that no camera sees their foot; of what shows no outer face at all, nothing is
    known.

    Args:
        top: highest surface, heights above the support plane.
        views: with depth.
        wall: fitted.
        points: of its faces.
        rim_height: above the support plane, metres.
        base: height of the underside above the support plane, metres.
        region: with the support plane and the depth's noise.
    """
    xy, heights = cells_beside(top, wall.shape)
    open_sectors = np.abs(medians_by_sector(xy, heights, wall.shape) - base) \
        < BASE_SETTINGS.min_height
    in_the_open = points.select(open_sectors[sectors(points.xy, wall.shape)])
    if _shows_lower(views, wall.shape, min(base, 0.0), rim_height, region) \
            or _has_ledge(wall.shape, in_the_open, rim_height - base, region.noise):
        return False
    if wall.shape.kind != "box":
        return True
    side = _sides(points.xy, wall.shape)
    edges = np.array([find_lower_edge(wall.shape, points.select(side == i), rim_height)
                      for i in range(4)])
    short = (edges < rim_height) & (edges - max(base, 0.0) >= SETTINGS.max_unseen_foot)
    # Whether the ground shows beside each side.
    level, beside = np.abs(heights - base) < BASE_SETTINGS.min_height, _sides(xy, wall.shape)
    open_sides = np.bincount(beside, level, 4) >= SETTINGS.min_open_share \
        * np.maximum(np.bincount(beside, minlength=4), 1)
    return bool(np.count_nonzero(short & open_sides) < SETTINGS.min_short_sides)


def _sides(xy: np.ndarray, shape: WallShape) -> np.ndarray:
    """(n,) int, the side of a box, 0 to 3, that is nearest to (n, 2) world points."""
    normals = shape.outward_normals(xy)
    turn = np.arctan2(normals[:, 1], normals[:, 0]) - shape.yaw
    return np.round(turn / (np.pi / 2)).astype(int) % 4


def _has_ledge(shape: WallShape, points: FacePoints, height: float, noise: float) -> bool:
    """Whether a wall's outer face steps outwards somewhere on its way down, and nowhere inwards.

    A rim's lip, a rib and a groove step both ways.

    Args:
        shape: outer face of the wall.
        points: of its faces, with others among them.
        height: from the underside to the rim, metres.
        noise: standard deviation of a depth point, metres.
    """
    s = SETTINGS
    # Median distance inside the face of each slice, from the rim down to right above the foot.
    inside = shape.depth_inside(points.xy, points.below)
    outer = ~points.inner & (np.abs(inside) < s.profile_reach) \
        & (points.below < height - s.max_unseen_foot)
    inside, number = inside[outer], (points.below[outer] / s.slice).astype(int)
    counts = np.bincount(number)
    shown = np.nonzero(counts >= s.min_slice_points)[0]
    if len(shown) < 3:
        return False
    profile = np.array([np.median(inside[number == i]) for i in shown])
    # A slice may lie across the edge: steps are over two, beside what the wall leans everywhere.
    steps = profile[:-2] - profile[2:]
    steps -= np.median(steps)
    fewest = np.minimum(counts[shown][:-2], counts[shown][2:])
    ledge = s.ledge + s.ledge_errors * noise / np.sqrt(fewest)
    return bool(np.any(steps > ledge) and not np.any(steps < -ledge))


def _shows_lower(views: list[View], shape: WallShape, base: float, rim_height: float,
                 region: Region) -> bool:
    """Whether the views see what lies lower than a container's underside right beside its wall.

    Args:
        views: with depth.
        shape: outer face of the wall, world frame.
        base: height of the underside, at most that of the support plane, metres above it.
        rim_height: above that plane, metres.
        region: with the support plane and the depth's noise.
    """
    s = SETTINGS
    limit = region.plane_z + base - max(s.min_lower_m, s.lower_noise_factor * region.noise)
    lowest = region.plane_z - s.max_recess * rim_height

    def clouds() -> Iterator[np.ndarray]:
        return (geometry.world_points(view, s.lower_stride).reshape(-1, 3) for view in views)

    lower = _count_beside((points[(points[:, 2] < limit) & (points[:, 2] > lowest)]
                           for points in clouds()), shape)
    if np.mean(lower >= BASE_SETTINGS.min_cells) < s.min_lower_directions:
        return False  # as nearly always: the others need not be counted
    every = _count_beside((points[np.isfinite(points[:, 2])] for points in clouds()), shape)
    shows = (lower >= BASE_SETTINGS.min_cells) & (lower >= s.min_lower_share * every)
    return bool(np.mean(shows) >= s.min_lower_directions)


def _count_beside(clouds: Iterable[np.ndarray], shape: WallShape) -> np.ndarray:
    """(sectors,) number of world points right beside a wall, of several times (n, 3), metres."""
    counts = np.zeros(BASE_SETTINGS.sectors, int)
    for points in clouds:
        inside = shape.depth_inside(points[:, :2], np.zeros(len(points)))
        counts += np.bincount(sectors(points[is_beside(inside), :2], shape),
                              minlength=BASE_SETTINGS.sectors)
    return counts
