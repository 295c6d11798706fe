# SPDX-License-Identifier: Apache-2.0
"""Openings of containers that stand side by side, or on something that is wider than they are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage

from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.types import HeightMap


@dataclass(frozen=True)
class OpeningSettings:
    """What is an opening: a hollow that level walls enclose; all values are chosen.

    Attributes:
        cell: least side of a cell of the map in which walls are closed lines, m.
        step: step from one height that is tried as a rim's to the next, m.
        level: largest distance of a wall's crest from its rim's height, m.
        min_depth: least height of a rim above what its opening shows, m.
        min_side: least width of an opening, m.
        min_side_parts: the same in part lengths.
        min_area_share: least area of an opening, over that of the largest.
        min_convexity: least area of an opening, over that of its convex hull.
        min_rim_share: least share of an opening's border that is level with its rim.
        wall_width: largest width of a wall, m.
        max_spare_share: largest area of other things beside an opening's wall, over the
            opening's, for which the whole is looked at as one container.
        spare: height above the rim that a pasted region leaves for parts, m.
        margin: distance between such a region's faces and the wall, m.
    """

    cell: float = 0.0025
    step: float = 0.002
    level: float = 0.004
    min_depth: float = 0.008
    min_side: float = 0.04
    min_side_parts: float = 2.5
    min_area_share: float = 0.2
    min_convexity: float = 0.85
    min_rim_share: float = 0.75
    wall_width: float = 0.025
    max_spare_share: float = 0.1
    spare: float = 0.1
    margin: float = 0.004


SETTINGS = OpeningSettings()


@dataclass(frozen=True, eq=False)
class FoundPlace:
    """Where a container stands.

    Attributes:
        low, high: (2,) corners of the upright rectangle around its wall, world, metres.
        rim_height: above the support plane, metres.
    """

    low: np.ndarray
    high: np.ndarray
    rim_height: float


@dataclass(frozen=True, eq=False)
class Opening(FoundPlace):
    """A hollow that level walls enclose.

    Attributes:
        cells: (rows, cols) bool, its cells in the map that it was found in.
    """

    cells: np.ndarray


def find_openings(top: HeightMap, unit_volume: float = 0.0) -> list[Opening]:
    """Finds all the openings in a map, the largest first.

    Seen from above, a rim is the highest level at which its opening is enclosed.

    Args:
        top: highest surface, heights above the support plane; its axes are the world's.
        unit_volume: volume of one part, m3, whose own holes are no openings; 0: not known.
    """
    s = SETTINGS
    # The highest surface in coarse cells, in which thin walls are closed lines.
    pool = max(round(s.cell / top.pitch), 1)
    heights, pitch = _pooled(top.heights, pool), pool * top.pitch
    min_side = max(s.min_side, s.min_side_parts * unit_volume**(1 / 3))
    found: list[Opening] = []
    taken = np.zeros(heights.shape, bool)
    # What is enclosed at each height, from the highest down, and was not at a higher one.
    for height in np.arange(float(heights.max()), s.min_depth, -s.step):
        walls = cv2.copyMakeBorder((heights > height - s.level).astype(np.uint8), 1, 1, 1, 1,
                                   cv2.BORDER_CONSTANT, value=0)
        walls = cv2.morphologyEx(walls, cv2.MORPH_CLOSE, np.ones((3, 3), np.uint8))[1:-1, 1:-1]
        count, labels, stats, _ = cv2.connectedComponentsWithStats(1 - walls, connectivity=4)
        for label in range(1, count):
            if stats[label, cv2.CC_STAT_AREA] * pitch**2 < min_side**2:
                continue
            cells = labels == label
            if np.any(cells & taken):
                continue
            rim_height = _rim_height(cells, heights, pitch, min_side)
            if rim_height:
                taken |= cells
                found.append(_make_opening(cells, rim_height, pool, top))
    found.sort(key=lambda opening: -np.count_nonzero(opening.cells))
    return [opening for opening in found if np.count_nonzero(opening.cells)
            >= s.min_area_share * np.count_nonzero(found[0].cells)]


def isolate_opening(top: HeightMap, opening: Opening) -> HeightMap:
    """The map without what lies beyond an opening's wall; itself where little does."""
    s = SETTINGS
    heights = np.nan_to_num(top.heights, nan=0.0)
    distance = ndimage.distance_transform_edt(~opening.cells) * top.pitch
    beyond = (heights > s.min_depth) & (distance > s.wall_width)
    if np.count_nonzero(beyond) <= s.max_spare_share * np.count_nonzero(opening.cells):
        return top
    kept = distance <= _wall_width(opening, heights, distance, top.pitch) + top.pitch
    return replace(top, heights=np.where(kept, top.heights, np.float32(np.nan)))


def several_containers(places: Sequence[FoundPlace], region: Region) -> ScanError:
    """The refusal of a scan of several containers: each with a region ready to paste.

    Args:
        places: two or more.
        region: whose support plane they were found above.
    """
    s, lines = SETTINGS, []
    for place in sorted(places, key=lambda p: tuple(np.round((p.low + p.high) / 2, 2))):
        low = np.append(place.low - s.margin, region.plane_z - s.margin)
        high = np.append(place.high + s.margin, region.plane_z + place.rim_height + s.spare)
        center, size = ([round(float(x), 4) for x in corner]
                        for corner in ((low + high) / 2, high - low))
        width, length = 1000 * (place.high - place.low)
        lines.append(f"{width:.0f} x {length:.0f} mm at roi_center_m: {center}, "
                     f"roi_size_m: {size}")
    return ScanError(f"{len(places)} containers; expected one, or a region of interest around one "
                     f"of them: {'; '.join(lines)}")


def _pooled(heights: np.ndarray, pool: int) -> np.ndarray:
    """The highest of every pool x pool cells of (rows, cols) heights, metres; 0 where unseen."""
    rows, cols = (-(-n // pool) * pool for n in heights.shape)
    padded = np.zeros((rows, cols), np.float32)
    padded[:heights.shape[0], :heights.shape[1]] = np.nan_to_num(heights, nan=0.0)
    return padded.reshape(rows // pool, pool, cols // pool, pool).max(axis=(1, 3))


def _rim_height(cells: np.ndarray, heights: np.ndarray, pitch: float, min_side: float) -> float:
    """Height of the rim around enclosed cells, metres; 0 if they are no opening.

    An opening is wide, convex, deep, and walled at one height.

    Args:
        cells: (rows, cols) bool.
        heights: (rows, cols) metres.
        pitch: side of a cell, metres.
        min_side: least width, metres.
    """
    s = SETTINGS
    if cells[0].any() or cells[-1].any() or cells[:, 0].any() or cells[:, -1].any():
        return 0.0
    points = np.stack(np.nonzero(cells)[::-1], axis=1).astype(np.float32)
    sides = np.array(cv2.minAreaRect(points)[1]) + 1
    hull = cv2.fillConvexPoly(np.zeros(cells.shape, np.uint8),
                              cv2.convexHull(points).astype(np.int32), 1)
    if sides.min() * pitch < min_side \
            or np.count_nonzero(cells) < s.min_convexity * np.count_nonzero(hull):
        return 0.0
    # The crest beside each cell of the border: a wall may be one cell wide.
    outline = ndimage.binary_dilation(cells, np.ones((3, 3))) & ~cells
    crest = ndimage.maximum_filter(np.where(cells, 0, heights), size=3)[outline]
    rim_height = float(np.median(crest))
    level = float(np.mean(np.abs(crest - rim_height) < s.level))
    deep = np.median(heights[cells]) < rim_height - s.min_depth
    return rim_height if deep and level >= s.min_rim_share else 0.0


def _make_opening(cells: np.ndarray, rim_height: float, pool: int, top: HeightMap) -> Opening:
    """The opening of enclosed cells of a map that is `pool` times as coarse as `top`."""
    T, pitch = top.T_world_map, top.pitch
    rows, cols = top.heights.shape
    fine = np.repeat(np.repeat(cells, pool, axis=0), pool, axis=1)[:rows, :cols]
    rows, cols = np.nonzero(fine)
    corners = np.array([[cols.min(), rows.min()], [cols.max() + 1, rows.max() + 1]]) * pitch
    low, high = corners @ T[:2, :2].T + T[:2, 3]
    opening = Opening(low, high, rim_height, fine)
    distance = ndimage.distance_transform_edt(~fine) * pitch
    width = _wall_width(opening, np.nan_to_num(top.heights, nan=0.0), distance, pitch)
    return replace(opening, low=low - width, high=high + width)


def _wall_width(opening: Opening, heights: np.ndarray, distance: np.ndarray, pitch: float
                ) -> float:
    """Width of an opening's wall, metres: up to where half as much is level with its rim.

    Args:
        opening: of the map.
        heights: (rows, cols) metres.
        distance: (rows, cols) metres from the opening.
        pitch: side of a cell, metres.
    """
    s = SETTINGS
    near = (distance > 0) & (distance <= s.wall_width)
    step = (distance[near] / pitch).astype(int)
    level = np.bincount(step, np.abs(heights[near] - opening.rim_height) < s.level) \
        / np.maximum(np.bincount(step), 1)
    crest = int(np.argmax(level[:int(np.ceil(s.wall_width / 2 / pitch)) + 1]))
    ends = np.nonzero(level[crest:] < level[crest] / 2)[0]
    return float(crest + (ends[0] if len(ends) else len(level) - crest)) * pitch
