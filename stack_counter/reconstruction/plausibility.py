# SPDX-License-Identifier: Apache-2.0
"""Whether a scan can be right at all: one container, and not cut off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.container.openings import FoundPlace, several_containers
from stack_counter.container.rim import Rim, find_rim
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region, find_blobs
from stack_counter.types import HeightMap, View


@dataclass(frozen=True)
class PlausibilitySettings:
    """When a scan is refused or flagged; all values are chosen.

    Attributes:
        min_rim_points: least number of points that show a rim.
        border_px: width of an image's border, pixels.
        max_border_share: largest share of the border that may show something standing.
        container_stride: pixels between the points in which a second container is looked for.
        container_cell_m: side of a cell of the map for that, m.
        min_rim_share: least share of its outline on which a second container's rim must show.
        max_containers: largest number of things beside the region that are looked at.
    """

    min_rim_points: int = 50
    border_px: int = 3
    max_border_share: float = 0.02
    container_stride: int = 4
    container_cell_m: float = 0.004
    min_rim_share: float = 0.85
    max_containers: int = 12


SETTINGS = PlausibilitySettings()


def stack_leaves_every_image(views: list[View], region: Region) -> bool:
    """Whether every view shows something standing on the support plane at its image's border."""
    return all(_is_cut(view, region) for view in views)


def _is_cut(view: View, region: Region) -> bool:
    """Whether something that stands in the region reaches the border of a view's image."""
    points = geometry.world_points(view)
    standing = region.contains(points) & (points[..., 2] > region.plane_z + region.noise_height)
    b = SETTINGS.border_px
    border = [standing[:b], standing[-b:], standing[:, :b], standing[:, -b:]]
    share = np.concatenate([strip.ravel() for strip in border]).mean()
    return bool(share > SETTINGS.max_border_share)


def stack_leaves_region(top: HeightMap) -> bool:
    """Whether a heap reaches the border of the region of interest.

    Args:
        top: map of the region; NaN beside the heap.
    """
    heap = np.isfinite(top.heights)
    border = np.concatenate([heap[:2].ravel(), heap[-2:].ravel(), heap[:, :2].ravel(),
                             heap[:, -2:].ravel()])
    return bool(border.mean() > SETTINGS.max_border_share)


def refuse_further_containers(views: list[View], region: Region) -> ScanError | None:
    """The refusal of a scan whose region holds a container where others stand beside it.

    Args:
        views: whole images with depth, of the first views.
        region: found around the largest thing in sight.

    Returns:
        None if there are no two containers.
    """
    # Split what stands on the support plane into the region's and other things.
    points = np.concatenate([geometry.world_points(view, SETTINGS.container_stride).reshape(-1, 3)
                             for view in views])
    points = points[np.isfinite(points[:, 2])]
    points = points[points[:, 2] > region.plane_z + region.noise_height]
    inside = region.contains(points)
    # Look for a rim in each.
    own = _find_coarse_rim(points[inside], region)
    if own is None:
        return None
    others = [_find_coarse_rim(blob, region)
              for blob in find_blobs(points[~inside])[:SETTINGS.max_containers]]
    rims = [own, *(rim for rim in others if rim is not None)]
    if len(rims) < 2:
        return None
    outlines = [rim.outline.ring(0.0, 0.0) for rim in rims]
    return several_containers([FoundPlace(outline.min(axis=0), outline.max(axis=0), rim.height)
                               for outline, rim in zip(outlines, rims)], region)


def _find_coarse_rim(points: np.ndarray, region: Region) -> Rim | None:
    """Finds a rectangular or round rim in a few views' points; None if none is sure."""
    if len(points) < SETTINGS.min_rim_points:
        return None
    # Map the highest point of every cell.
    cell = SETTINGS.container_cell_m
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
