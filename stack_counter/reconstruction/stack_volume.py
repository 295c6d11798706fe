# SPDX-License-Identifier: Apache-2.0
"""V: the integral between the inner surface and the highest surface.

Source: paper, section 3.3; what V means is defined in README.md and docs (`stack_volume`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter.container.construction import with_floor
from stack_counter.container.inner_surface import map_rim_opening
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import volume_model
from stack_counter.reconstruction.heap import measure_heap
from stack_counter.reconstruction.integral import (
    MeasuredStack,
    StackBoundary,
    fill_unknown_cells,
    integrate_fill,
    volume_std,
)
from stack_counter.types import Container


@dataclass(frozen=True)
class FloorSettings:
    """Where the wall's shoulder ends, what is seen through it, and what shows a floor.

    Attributes:
        through_m: how far below the inner surface and the floor's thickness a surface lies that
            stands behind the wall, m; chosen.
        shoulder_cells: cells next to a wall in which the fused surface is the wall's rounded
            shoulder; chosen.
        flatness_m: how level a visible floor is, m; chosen.
        min_gap_cells: cells next to a part in which the fused surface has not come down to the
            floor yet; chosen.
        min_share: share of the floor's cells in which it must show, where it lies as high as
            expected; chosen.
        min_share_higher: the same where it lies higher; chosen.
        max_height: height to which a higher floor may lie, relative to the rim's; chosen.
    """

    through_m: float = 0.005
    shoulder_cells: float = 1.5
    flatness_m: float = 0.002
    min_gap_cells: int = 2
    min_share: float = 0.01
    min_share_higher: float = 0.4
    max_height: float = 0.12


SETTINGS = FloorSettings()


def measure_stack(surface: FusedSurface, container: Container, region: Region, pitch: float,
                  floor_known: bool, one_side: bool = False) -> MeasuredStack:
    """Integrates the stack over the container's opening, or over the heap's footprint.

    Cells that no view saw are filled in from those beside them.

    Args:
        surface: fused surface, world frame.
        container: with rings, or of kind `none`.
        region: where a heap is looked for.
        pitch: side of a map cell, m: the voxel's.
        floor_known: the floor's thickness is configured, so it is not looked for.
        one_side: all views come from one side, as those of a single fixed camera.

    Raises:
        ScanError: nothing of the footprint was seen.
        WeightsError: the shipped model of V's bias and errors cannot be read.
    """
    if container.kind == "none":
        return measure_heap(surface, container, region, pitch, one_side)
    return _measure_in_container(surface, container, region, pitch, floor_known, one_side)


def _measure_in_container(surface: FusedSurface, container: Container, region: Region,
                          pitch: float, floor_known: bool, one_side: bool) -> MeasuredStack:
    """Integrates the stack over a container's opening; arguments as of `measure_stack`.

    Raises:
        ScanError: nothing of the opening was seen.
    """
    model = volume_model()
    # Map the inner surface and the highest one over the opening; fill unseen cells in.
    rim_opening = map_rim_opening(container, pitch)
    inner = rim_opening.inner
    opening = np.isfinite(inner.heights)
    top = surface.heights(inner.T_world_map, pitch, inner.heights.shape)
    seen = np.isfinite(top.heights)
    inside = _without_shoulder(opening)
    # Below a leaning wall shows what stands behind it, where the fused surface has lost the wall.
    lowest = inner.heights - container.floor_thickness_m - SETTINGS.through_m
    below = top.heights < lowest
    heights = fill_unknown_cells(np.where(below, np.nan, top.heights), inside)
    # Replace the assumed floor by the visible one.
    if not floor_known:
        on_floor = opening & (inner.heights <= np.float32(container.floor_thickness_m))
        rim_height = container.floor_thickness_m + container.inner_size_m[2]
        floor = find_floor(heights, on_floor, container.floor_thickness_m, rim_height)
        floor_known = floor is not None
        if floor is not None:
            container = with_floor(container, floor)
            rim_opening = map_rim_opening(container, pitch)
            inner = rim_opening.inner
    # Integrate the fill between the two surfaces.
    integral = integrate_fill((heights - inner.heights)[opening], (seen & ~below)[opening],
                              rim_opening.area / np.count_nonzero(opening),
                              model.hidden_share_one_side if one_side else model.hidden_share,
                              model.worn_height_m, ~inside[opening])
    boundary = StackBoundary(
        is_heap=False, rim_length=_rim_length(container), opening_area=rim_opening.area,
        assumed_floor=0.0 if floor_known else container.floor_thickness_m)
    # Express the fill as shares of the depth.
    depth = container.inner_size_m[2]
    low, high = np.percentile(integral.fill, [1, 99])
    fill_level = (float(low) / depth, float(integral.fill.mean()) / depth, float(high) / depth)
    return MeasuredStack(
        integral=integral, stack_volume_std=volume_std(integral, boundary, region.noise, model),
        boundary=boundary,
        top=replace(top, heights=np.where(opening, heights, np.nan).astype(np.float32)),
        inner=inner, seen=seen, below=below, coverage=float(seen[opening].mean()),
        fill_level=fill_level, container=container)


def _rim_length(container: Container) -> float:
    """Length of a container's inner rim, m."""
    assert container.rings is not None  # for the type checker
    sides = np.roll(container.rings[-1], -1, axis=0) - container.rings[-1]
    return float(np.linalg.norm(sides, axis=1).sum())


def _without_shoulder(opening: np.ndarray) -> np.ndarray:
    """Erodes an opening (rows, cols) by the wall's shoulder; all of it where nothing is left."""
    distance = ndimage.distance_transform_edt(np.pad(opening, 1))[1:-1, 1:-1]
    inside = distance > SETTINGS.shoulder_cells + 0.5
    return inside if inside.any() else opening


def find_floor(heights: np.ndarray, on_floor: np.ndarray, assumed: float, rim_height: float
               ) -> float | None:
    """Finds the height of a container's floor where it shows.

    It shows where the lowest cells lie level over an area, not only in gaps between parts, which
    the fused surface fills; and either lie where a floor is expected or, not much higher, fill
    half of the footprint (a bin that is empty or nearly so).

    Args:
        heights: (rows, cols) float, m above the support plane.
        on_floor: (rows, cols) bool, the cells above the floor, not above a sloping wall.
        assumed: height where the floor is expected, m above the support plane.
        rim_height: height of the rim, m above the support plane.

    Returns:
        Its height above the support plane, m; None where it does not show.
    """
    if not on_floor.any():
        return None
    # Find the level area at the lowest cells, clear of parts.
    low = float(np.percentile(heights[on_floor], 2))
    level = on_floor & (np.abs(heights - low) < SETTINGS.flatness_m)
    level = ndimage.binary_erosion(level, iterations=SETTINGS.min_gap_cells)
    share = np.count_nonzero(level) / np.count_nonzero(on_floor)
    # Accept it as expected, or as a higher floor that fills much of the footprint.
    as_expected = share > SETTINGS.min_share and low < assumed + SETTINGS.flatness_m
    if as_expected or (share > SETTINGS.min_share_higher
                       and low < SETTINGS.max_height * rim_height):
        return max(float(np.median(heights[level])), 0.0)
    return None
