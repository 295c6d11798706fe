"""V: the integral between the inner surface and the highest surface (design: `stack_volume`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.region import Region
from stack_counter.tsdf import TopView
from stack_counter.types import Container, HeightMap

_EDGE = 1.5  # voxels next to a wall in which the fused surface is the wall's rounded shoulder
_NOISE = 0.002  # bin: what stands less than this above the floor is noise, m
_HIGHEST_FLOOR = 0.12  # of the rim's height, that a floor may lie above the support plane
_FLAT = 0.002  # how level a visible floor is, m
_LEVEL_ERROR = 0.0007  # standard deviation of a fused height's common error, m
_EDGE_ERROR = 0.0010  # standard deviation of a fitted wall's place, m
# Relative standard deviations on the training piles beyond the parts above: hidden gaps that the
# fused surface bridges; parts that lie apart from a heap.
_GAP_ERROR, _HEAP_ERROR = 0.04, 0.08
_FILL_ERROR = 0.25  # relative standard deviation of a height that was filled in


@dataclass(frozen=True)
class Measure:
    """V and its standard deviation (m3), the maps it was integrated from (None without depth),
    the share of the footprint that was seen, min, mean and max fill level, and the container
    with its floor."""

    stack_volume: float
    stack_volume_std: float
    top: HeightMap | None
    inner: HeightMap | None
    coverage: float
    fill_level: tuple[float, float, float]
    container: Container


def measure(view: TopView, container: Container, region: Region, pitch: float,
            floor_known: bool) -> Measure:
    """Integrates the stack over the container's opening, or over the heap's footprint.

    Cells that no view saw take the height of the nearest cell that was seen.

    Args:
        view: fused surface.
        container: kind `box` or `none`.
        region: where a heap is looked for.
        pitch: side of a map cell, m: the voxel's.
        floor_known: the floor's thickness is configured, so it is not looked for.

    Raises:
        ScanError: nothing of the footprint was seen.
    """
    if container.kind == "none":
        return _measure_heap(view, container, region, pitch)
    return _measure_box(view, container, pitch, floor_known)


def _measure_box(view: TopView, container: Container, pitch: float, floor_known: bool) -> Measure:
    width, length, depth = container.inner_size_m
    shape = (max(round(length / pitch), 1), max(round(width / pitch), 1))
    T_world_map = container.T_world_container @ geometry.pose(
        np.eye(3), np.array([-shape[1] * pitch / 2, -shape[0] * pitch / 2, 0]))
    top = view.heights(T_world_map, pitch, shape)
    seen = np.isfinite(top.heights)
    heights, coverage = _filled(top.heights, _away_from_walls(shape)), float(seen.mean())
    rim = container.floor_thickness_m + depth
    floor = container.floor_thickness_m
    if not floor_known:
        floor = _visible_floor(heights, floor, rim)
        container = replace(container, floor_thickness_m=floor,
                            inner_size_m=(width, length, rim - floor))
    fill = heights - floor
    fill = np.where(fill < _NOISE, 0.0, fill)
    volume = float(fill.mean()) * width * length
    mean, std = volume / (width * length), 0.0
    if volume > 0:
        edges = mean * _EDGE_ERROR * np.sqrt(2 * width**2 + 2 * length**2)
        std = float(np.sqrt((_LEVEL_ERROR * width * length) ** 2 + edges**2
                            + (_GAP_ERROR * volume) ** 2
                            + ((1 - coverage) * _FILL_ERROR * volume) ** 2))
    low, high = np.percentile(fill, [1, 99])
    level = tuple(float(x / (rim - floor)) for x in (low, mean, high))
    inner = HeightMap(T_world_map, pitch, np.full(shape, floor, np.float32))
    return Measure(volume, std, replace(top, heights=heights.astype(np.float32)), inner, coverage,
                   (level[0], level[1], level[2]), container)


def _away_from_walls(shape: tuple[int, int]) -> np.ndarray:
    edge = int(np.ceil(_EDGE))
    inside = np.zeros(shape, bool)
    inside[edge:-edge, edge:-edge] = True
    return inside if inside.any() else np.ones(shape, bool)


def _filled(heights: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """Heights with every cell that is not seen and trusted taken from its neighbours.

    What no view saw lies hidden below what hides it: such a cell takes the lowest of the known
    cells next to it, from the border of a hole inwards.
    """
    good = np.isfinite(heights) & trusted
    if not good.any():
        raise ScanError(f"{np.count_nonzero(np.isfinite(heights))} cells of the footprint seen; "
                        "expected some: no view looks into it")
    out = np.where(good, heights, np.inf)
    while not good.all():
        lowest = ndimage.minimum_filter(out, 3, mode="nearest")
        new = ~good & np.isfinite(lowest)
        out[new] = lowest[new]
        good |= new
    return out


def _visible_floor(heights: np.ndarray, assumed: float, rim: float) -> float:
    """Height of the floor where it shows, else as assumed.

    It shows if the lowest cells lie level, and either lie where a floor is expected or, not much
    higher, fill half of the footprint (a bin that is empty or nearly so).
    """
    low = float(np.percentile(heights, 2))
    level = np.abs(heights - low) < _FLAT
    if (level.mean() > 0.05 and low < assumed + _FLAT) \
            or (level.mean() > 0.5 and low < _HIGHEST_FLOOR * rim):
        return max(float(np.median(heights[level])), 0.0)
    return assumed


def _measure_heap(view: TopView, container: Container, region: Region, pitch: float) -> Measure:
    shape = tuple(int(n) for n in np.ceil((region.high - region.low)[1::-1] / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    top = view.heights(T_world_map, pitch, (shape[0], shape[1]))
    stack = ndimage.binary_fill_holes(np.nan_to_num(top.heights, nan=0.0) > region.lowest)
    coverage = float(np.isfinite(top.heights[stack]).mean()) if stack.any() else 1.0
    heights = _filled(top.heights, np.ones(shape, bool))
    heights = np.where(stack, np.maximum(heights, 0.0), np.nan).astype(np.float32)
    area = np.count_nonzero(stack) * pitch**2
    volume = float(np.nansum(heights)) * pitch**2
    outline = np.count_nonzero(stack & ~ndimage.binary_erosion(stack)) * pitch
    mean = volume / area if area else 0.0
    std = float(np.sqrt((_LEVEL_ERROR * area) ** 2 + (mean * _EDGE_ERROR * outline) ** 2 / 4
                        + (_HEAP_ERROR * volume) ** 2
                        + ((1 - coverage) * _FILL_ERROR * volume) ** 2))
    inner = HeightMap(T_world_map, pitch, np.zeros(shape, np.float32))
    return Measure(volume, std, replace(top, heights=heights), inner, coverage, (0.0, 0.0, 0.0),
                   container)
