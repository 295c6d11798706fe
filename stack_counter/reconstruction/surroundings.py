# SPDX-License-Identifier: Apache-2.0
"""What stands beside the thing that is measured, where no region says which one is meant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.container.openings import FoundPlace, several_containers
from stack_counter.container.rim import Rim, find_rim
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region, find_blobs
from stack_counter.types import Container, HeightMap, View


@dataclass(frozen=True)
class SurroundingsSettings:
    """When another thing counts as a second container, or as large as the first; all chosen.

    Attributes:
        stride: pixels between the points that are looked at.
        cell_m: side of a cell of the maps, m.
        min_points: least number of points of a thing.
        max_things: largest number of things beside the region that are looked at.
        min_rim_share: least share of its outline on which a container's rim must show.
        large_share: least footprint and height, over the first one's, of one as large.
        beside_m: distance from a container's rim up to which its wall and handles reach, m.
        beside_height_share: least height, over the container's and above its underside, of one
            as large within the same region, which may hold what the container stands by.
        height_percentile: percentile of a thing's points that is its height.
    """

    stride: int = 4
    cell_m: float = 0.004
    min_points: int = 50
    max_things: int = 12
    min_rim_share: float = 0.85
    large_share: float = 0.4
    beside_m: float = 0.025
    beside_height_share: float = 0.8
    height_percentile: float = 95.0


SETTINGS = SurroundingsSettings()


@dataclass(frozen=True)
class Surroundings:
    """What stands beside the largest thing in sight.

    Attributes:
        refusal: of a scan of several containers, with their places; None for one or none.
        is_crowded: something about as large stands beside it, whatever that is.
        standing: (n, 3) points of it, and of what is near it, world, metres; None: not looked at.
    """

    refusal: ScanError | None = None
    is_crowded: bool = False
    standing: np.ndarray | None = None

    def are_crowded_around(self, container: Container) -> bool:
        """Whether something about as large as a container that was found stands beside it.

        Heights are those above its underside: what it stands on is not beside it.
        """
        if self.is_crowded or self.standing is None or container.wall_shape is None:
            return self.is_crowded
        T = container.T_world_container
        points = geometry.apply(geometry.inverse(T), self.standing)
        points = points[points[:, 2] > 0]
        inside = container.wall_shape.depth_inside(points[:, :2], np.zeros(len(points)))
        beside = inside < -SETTINGS.beside_m
        return _is_as_large(points[beside], points[~beside], 0.0, SETTINGS.beside_height_share)


def inspect_surroundings(views: list[View], region: Region) -> Surroundings:
    """Looks at what stands beside the largest thing in sight.

    Args:
        views: whole images with depth, of the first views.
        region: found around that thing.
    """
    # Split what stands on the support plane into the region's and other things.
    points = np.concatenate([geometry.world_points(view, SETTINGS.stride).reshape(-1, 3)
                             for view in views])
    points = points[np.isfinite(points[:, 2])]
    points = points[points[:, 2] > region.plane_z + region.noise_height]
    inside = region.contains(points)
    own, others = points[inside], find_blobs(points[~inside])[:SETTINGS.max_things]
    is_crowded = any(_is_as_large(other, own, region.plane_z, SETTINGS.large_share)
                     for other in others)
    # Look for a rim in each.
    rims = [rim for rim in (_find_coarse_rim(thing, region) for thing in (own, *others))
            if rim is not None]
    if len(rims) < 2:
        return Surroundings(None, is_crowded, own)
    outlines = [rim.outline.ring(0.0, 0.0) for rim in rims]
    return Surroundings(several_containers(
        [FoundPlace(outline.min(axis=0), outline.max(axis=0), rim.height)
         for outline, rim in zip(outlines, rims)], region), is_crowded)


def _is_as_large(other: np.ndarray, own: np.ndarray, base: float, height_share: float) -> bool:
    """Whether (n, 3) points show a thing about as wide and as high as (m, 3) others do.

    Both stand at z = `base`, metres.
    """
    s = SETTINGS
    if min(len(other), len(own)) < s.min_points:
        return False
    area, own_area = (len(np.unique(np.floor(points[:, :2] / s.cell_m), axis=0))
                      for points in (other, own))
    height, own_height = (np.percentile(points[:, 2], s.height_percentile) - base
                          for points in (other, own))
    return bool(area >= s.large_share * own_area and height >= height_share * own_height)


def _find_coarse_rim(points: np.ndarray, region: Region) -> Rim | None:
    """Finds a rectangular or round rim in a few views' points; None if none is sure."""
    if len(points) < SETTINGS.min_points:
        return None
    # Map the highest point of every cell.
    cell = SETTINGS.cell_m
    low = points[:, :2].min(axis=0) - 2 * cell
    cells = ((points[:, :2] - low) / cell).astype(int)
    heights = np.full(cells.max(axis=0)[::-1] + 3, -np.inf, np.float32)
    np.maximum.at(heights, (cells[:, 1], cells[:, 0]), points[:, 2] - region.plane_z)
    heights[np.isinf(heights)] = np.nan
    # Find the rim in the map.
    T_world_map = geometry.pose(np.eye(3), np.append(low, region.plane_z))
    rim = find_rim(HeightMap(T_world_map, cell, heights), region.noise_height, "auto")
    is_sure = rim is not None and rim.outline_share >= SETTINGS.min_rim_share \
        and rim.outline.kind in ("box", "round")
    return rim if is_sure else None
