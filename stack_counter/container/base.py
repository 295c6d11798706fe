# SPDX-License-Identifier: Apache-2.0
"""Height of a container's underside: it may stand on a board, a rail or another container."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.rim import map_depth_inside
from stack_counter.container.wall_fit import FacePoints, FittedWall
from stack_counter.fusion.region import Region
from stack_counter.types import BACKGROUND, HeightMap, View, WallShape


@dataclass(frozen=True)
class BaseSettings:
    """How the underside is found beside and below the container; all values are chosen.

    Attributes:
        sectors: directions around the container in each of which it is looked for.
        strip_start, strip_end: distances outside the rim's outline between which the ground is
            looked at, m.
        min_cells: least number of cells or points of a direction that shows something.
        agreement: largest distance of a direction's ground from the median of all, m.
        min_share: least share of the directions that must show the ground.
        min_agreeing_share: least share of these that must agree.
        min_height: least height above the support plane that counts as raised, m.
        noise_factor: the same in standard deviations of a depth point.
        same_floor: difference, m, up to which a given depth leaves the container on the plane.
        reach: distance from the outer face within which points are the wall's, m.
        slice: step of the heights at which such points are counted, m.
        min_slice_share: least number of points of a slice that shows the wall, over the typical.
        stride: pixels between the points that are looked for below the container.
        min_under: least distance inside the wall of a point that is seen below it, m.
        min_under_share: least share of the directions that show such points.
        max_draft: steepest overhang, m/m, of a wall whose lower edge shows from above.
    """

    sectors: int = 36
    strip_start: float = 0.003
    strip_end: float = 0.018
    min_cells: int = 6
    agreement: float = 0.005
    min_share: float = 0.4
    min_agreeing_share: float = 0.7
    min_height: float = 0.008
    noise_factor: float = 4.0
    same_floor: float = 0.005
    reach: float = 0.003
    slice: float = 0.003
    min_slice_share: float = 0.2
    stride: int = 4
    min_under: float = 0.008
    min_under_share: float = 0.15
    max_draft: float = 0.1


SETTINGS = BaseSettings()


def find_base(top: HeightMap, views: list[View], wall: FittedWall, points: FacePoints,
              rim_height: float, worn: float, region: Region, config: ReconstructorConfig
              ) -> float:
    """Height of a container's underside above the support plane, metres.

    It is configured, or follows from the rim and a configured depth, or is the height of the
    ground right beside the container, or of its wall's lower edge where one can see below it; 0
    where nothing shows that it is raised, or stands in a recess.

    Args:
        top: highest surface, heights above the support plane.
        views: with depth.
        wall: fitted.
        points: of its faces.
        rim_height: above the support plane, metres, as the fused surface shows it.
        worn: by how much that is too low, metres.
        region: with the support plane and the depth's noise.
        config: `container_base_m`, `container_inner_size_m` and `container_floor_m`.
    """
    s = SETTINGS
    if np.isfinite(config.container_base_m):
        return config.container_base_m
    lower_edge = find_lower_edge(wall.shape, points, rim_height)
    depth = config.container_inner_size_m[2]
    if depth:
        base = rim_height + worn - depth - (config.container_floor_m or wall.thickness)
        has_thick_floor = lower_edge < base - s.min_height
        return 0.0 if abs(base) < s.same_floor or has_thick_floor else base
    min_height = _min_height(region)
    # The wall of a container in a recess goes on below the support plane.
    xy, beside = cells_beside(top, wall.shape)
    lower = np.where(beside < -min_height, beside, np.nan)
    recess = _common_height(medians_by_sector(xy, lower, wall.shape))
    if recess is not None and lower_edge < s.min_height:
        return recess
    ground = _common_height(medians_by_sector(xy, beside, wall.shape))
    # The wall's own lower edge contradicts a ground that is another thing's top.
    if ground is not None and ground > min_height and lower_edge > ground - s.min_height:
        return ground
    if ground is not None and ground < min_height < lower_edge < rim_height - min_height \
            and _shows_below(views, wall.shape, rim_height, region):
        return lower_edge
    return 0.0


def find_lower_edge(shape: WallShape, points: FacePoints, rim_height: float) -> float:
    """Height down to which the outer face is seen without a gap, metres; `rim_height` for none.

    Args:
        shape: outer face of the wall.
        points: of its faces, with others among them.
        rim_height: above the support plane, metres.
    """
    s = SETTINGS
    distance = shape.depth_inside(points.xy, points.below)
    below = points.below[~points.inner & (np.abs(distance) < s.reach)]
    slices = max(int(np.ceil(rim_height / s.slice)), 1)
    counts = np.bincount((below / s.slice).astype(int), minlength=slices)[:slices]
    seen = counts >= max(s.min_slice_share * np.median(counts[counts > 0]), s.min_cells) \
        if counts.any() else np.zeros(slices, bool)
    if not seen.any():
        return rim_height
    first = int(np.argmax(seen))
    gaps = np.nonzero(~(seen[first:-1] | seen[first + 1:]))[0]  # two slices in a row
    last = first + int(gaps[0]) if len(gaps) else slices
    return max(rim_height - last * s.slice, 0.0)


def _common_height(heights: np.ndarray) -> float | None:
    """The height on which most directions agree, metres; None if they do not, or are few."""
    s = SETTINGS
    known = heights[np.isfinite(heights)]
    if len(known) < s.min_share * s.sectors:
        return None
    height = float(np.median(known))
    agree = np.abs(known - height) < s.agreement
    return height if np.mean(agree) >= s.min_agreeing_share else None


def _min_height(region: Region) -> float:
    """Distance from the support plane, metres, of what surely lies above or below it."""
    return max(SETTINGS.min_height, SETTINGS.noise_factor * region.noise)


def medians_by_sector(xy: np.ndarray, heights: np.ndarray, shape: WallShape) -> np.ndarray:
    """(sectors,) medians of (n,) heights at places (n, 2), metres; NaN for too few finite ones."""
    s, known = SETTINGS, np.isfinite(heights)
    heights, sector = heights[known], sectors(xy[known], shape)
    medians = np.full(s.sectors, np.nan)
    for i in np.nonzero(np.bincount(sector, minlength=s.sectors) >= s.min_cells)[0]:
        medians[i] = np.median(heights[sector == i])
    return medians


def cells_beside(top: HeightMap, shape: WallShape) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) world places of the cells right beside the wall, and their (n,) heights, metres."""
    beside = is_beside(map_depth_inside(top, shape))
    rows, cols = np.divmod(np.nonzero(beside)[0], top.heights.shape[1])
    cells = np.stack([cols + 0.5, rows + 0.5, np.zeros(len(rows))], axis=1) * top.pitch
    return geometry.apply(top.T_world_map, cells)[:, :2], top.heights.ravel()[beside]


def is_beside(inside: np.ndarray) -> np.ndarray:
    """(n,) bool of distances (n,) inside an outline, metres: those right outside of it."""
    return (inside < -SETTINGS.strip_start) & (inside > -SETTINGS.strip_end)


def _shows_below(views: list[View], shape: WallShape, rim_height: float, region: Region) -> bool:
    """Whether the views see what lies below the container, past the lower edge of its wall."""
    s = SETTINGS
    narrows = np.ptp(shape.ring(0.0, 0.0), axis=0) - np.ptp(shape.ring(rim_height, 0.0), axis=0)
    if narrows.max() / 2 > s.max_draft * rim_height:
        return False
    found = np.zeros(s.sectors, int)
    for view in views:
        points = geometry.world_points(view, s.stride)
        if view.labels is not None:  # the container hides what lies below it
            points = points[view.labels[::s.stride, ::s.stride] == BACKGROUND]
        points = points[region.contains(points)]
        z = points[:, 2] - region.plane_z
        # What lies inside the wall, below half its height, on the side that faces the camera.
        inside = shape.depth_inside(points[:, :2], np.clip(rim_height - z, 0.0, rim_height))
        ray = points[:, :2] - view.T_world_camera[:2, 3]
        inwards = np.sum(ray * shape.outward_normals(points[:, :2]), axis=1) < 0
        under = inwards & (z < rim_height / 2) & (inside > s.min_under)
        # The ray must have crossed the outline below the rim, not have come in over it.
        run = np.maximum(np.linalg.norm(ray, axis=1), 1e-6)
        fall = (view.T_world_camera[2, 3] - points[:, 2]) / run
        under &= z + fall * inside < rim_height / 2
        found += np.bincount(sectors(points[under, :2], shape), minlength=s.sectors)
    return bool(np.count_nonzero(found >= s.min_cells) >= s.min_under_share * s.sectors)


def sectors(xy: np.ndarray, shape: WallShape) -> np.ndarray:
    """(n,) int, the direction from the wall's middle in which (n, 2) world points lie."""
    offsets = xy - shape.center
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) % 1
    return (turn * SETTINGS.sectors).astype(int) % SETTINGS.sectors
