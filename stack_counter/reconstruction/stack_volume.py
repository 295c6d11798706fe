"""V: the integral between the inner surface and the highest surface (design: `stack_volume`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.container.construction import with_floor
from stack_counter.container.inner_surface import opening_map
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import Container, HeightMap

_EDGE = 1.5  # voxels next to a wall in which the fused surface is the wall's rounded shoulder
_NOISE = 0.002  # bin: what stands less than this above the floor is noise, m
_GROUND = 0.006  # how far from the support plane its own surface is looked for, m
_SPECK = 6  # cells: what is smaller is noise, not a part
_BETWEEN = 8  # cells: half of the widest gap between a heap's parts that was not seen
_DISC = np.hypot(*np.mgrid[-_BETWEEN:_BETWEEN + 1, -_BETWEEN:_BETWEEN + 1]) <= _BETWEEN
_HIGHEST_FLOOR = 0.12  # of the rim's height, that a floor may lie above the support plane
_FLAT = 0.002  # how level a visible floor is, m
_GAP = 2  # cells next to a part in which the fused surface has not come down to the floor yet
_SHOWS = 0.01  # share of the footprint where the floor must show
# What no view saw between parts and below the rim lies lower than the lowest that was seen beside
# it, and crests are worn down a little; both as measured on training scenes.
_HIDDEN, _WORN = 0.65, 0.0004
# One camera does not see much that lies as high as what it sees beside it: in a container, of a
# heap.
_HIDDEN_INSIDE, _HIDDEN_HEAP = 0.85, 1.0
# Standard deviations that agree with the errors on training scenes: the level of the surface, m,
# and per metre of the depth's noise; the wall's place, m; what was filled in, relative; a floor
# that was not seen, per wall thickness; the volume, relative, and that of a heap beyond it.
_LEVEL_ERROR, _NOISE_ERROR, _EDGE_ERROR = 0.0005, 0.25, 0.0003
_FILL_ERROR, _FLOOR_ERROR, _MODEL_ERROR, _HEAP_ERROR = 0.1, 0.1, 0.01, 0.04


@dataclass(frozen=True)
class MeasuredStack:
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


@dataclass(frozen=True)
class FillIntegral:
    """V and its parts: m3 over what was seen, m3 over what was filled in, area in m2 of the cells
    that hold something, and the fill of every cell, m."""

    volume: float
    filled_in: float
    area: float
    fill: np.ndarray


def _integral(fill: np.ndarray, seen: np.ndarray, cell_area: float, hidden: float) -> FillIntegral:
    """Integrates (n,) fill heights over cells of an area, m2, that were seen, or filled in: of
    those the share `hidden` counts."""
    fill = np.where(fill < _NOISE, 0.0, np.where(seen, fill, hidden * fill))
    fill = np.where(fill > 0, fill + _WORN, 0.0)
    return FillIntegral(float(fill.sum()) * cell_area, float(fill[~seen].sum()) * cell_area,
                        np.count_nonzero(fill) * cell_area, fill)


def _std(of: FillIntegral, region: Region, edge: float, *more: float) -> float:
    """Standard deviation of V in m3; `edge`: that of the walls' places in m2 of a vertical cut
    times m; `more`: further ones, m3."""
    parts = [(_LEVEL_ERROR + _NOISE_ERROR * region.noise) * of.area, _MODEL_ERROR * of.volume,
             _FILL_ERROR * of.filled_in, edge, *more]
    return float(np.linalg.norm(parts)) if of.volume > 0 else 0.0


def measure_stack(view: FusedSurface, container: Container, region: Region, pitch: float,
                  floor_known: bool, one_side: bool = False) -> MeasuredStack:
    """Integrates the stack over the container's opening, or over the heap's footprint.

    Cells that no view saw are filled in from those beside them.

    Args:
        view: fused surface.
        container: with rings, or of kind `none`.
        region: where a heap is looked for.
        pitch: side of a map cell, m: the voxel's.
        floor_known: the floor's thickness is configured, so it is not looked for.
        one_side: all views come from one side, as those of a single fixed camera.

    Raises:
        ScanError: nothing of the footprint was seen.
    """
    if container.kind == "none":
        return _measure_heap(view, container, region, pitch, one_side)
    return _measure_inside(view, container, region, pitch, floor_known, one_side)


def _measure_inside(view: FusedSurface, container: Container, region: Region, pitch: float,
                    floor_known: bool, one_side: bool) -> MeasuredStack:
    inner, area = opening_map(container, pitch)
    opening = np.isfinite(inner.heights)
    top = view.heights(inner.T_world_map, pitch, inner.heights.shape)
    seen = np.isfinite(top.heights)
    heights = filled(top.heights, _away_from_walls(opening))
    rim = container.floor_thickness_m + container.inner_size_m[2]
    if not floor_known:
        on_floor = opening & (inner.heights <= np.float32(container.floor_thickness_m))
        floor = _visible_floor(heights, on_floor, container.floor_thickness_m, rim)
        floor_known = floor is not None
        if floor is not None:
            container = with_floor(container, floor)
            inner, area = opening_map(container, pitch)
    of = _integral((heights - inner.heights)[opening], seen[opening],
                   area / np.count_nonzero(opening), _HIDDEN_INSIDE if one_side else _HIDDEN)
    assert container.rings is not None  # for the type checker
    sides = np.roll(container.rings[-1], -1, axis=0) - container.rings[-1]
    edge = _EDGE_ERROR * float(np.linalg.norm(sides, axis=1).sum()) * of.volume / area
    floor_error = 0.0 if floor_known else _FLOOR_ERROR * container.floor_thickness_m * of.area
    depth = container.inner_size_m[2]
    low, high = np.percentile(of.fill, [1, 99])
    heights = np.where(opening, heights, np.nan).astype(np.float32)
    return MeasuredStack(
        of.volume,
        _std(of, region, edge, floor_error),
        replace(top, heights=heights),
        inner,
        float(seen[opening].mean()),
        (float(low) / depth, float(of.fill.mean()) / depth, float(high) / depth),
        container,
    )


def _away_from_walls(opening: np.ndarray) -> np.ndarray:
    inside = ndimage.distance_transform_edt(np.pad(opening, 1))[1:-1, 1:-1] > _EDGE + 0.5
    return inside if inside.any() else opening


def filled(heights: np.ndarray, trusted: np.ndarray) -> np.ndarray:
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


def _visible_floor(heights: np.ndarray, on_floor: np.ndarray, assumed: float, rim: float
                   ) -> float | None:
    """Height of the floor where it shows, else None.

    It shows where the lowest cells lie level over an area, not only in gaps between parts, which
    the fused surface fills; and either lie where a floor is expected or, not much higher, fill
    half of the footprint (a bin that is empty or nearly so).
    """
    if not on_floor.any():
        return None
    low = float(np.percentile(heights[on_floor], 2))
    level = on_floor & (np.abs(heights - low) < _FLAT)
    level = ndimage.binary_erosion(level, iterations=_GAP)
    share = np.count_nonzero(level) / np.count_nonzero(on_floor)
    if (share > _SHOWS and low < assumed + _FLAT) or (share > 0.4 and low < _HIGHEST_FLOOR * rim):
        return max(float(np.median(heights[level])), 0.0)
    return None


def _standing(heights: np.ndarray, one_side: bool) -> np.ndarray:
    """(rows, cols) bool: the cells of a heap, what is unseen between them, but no specks."""
    known = heights[np.isfinite(heights)]
    ground = known[np.abs(known) < _GROUND]
    noise = 1.4826 * float(np.median(np.abs(ground))) if len(ground) else 0.0
    high = np.nan_to_num(heights, nan=0.0) > max(_NOISE, 4 * noise)
    if one_side:  # what lies unseen between parts belongs to them
        high |= ndimage.binary_closing(np.pad(high, _BETWEEN), _DISC)[
            _BETWEEN:-_BETWEEN, _BETWEEN:-_BETWEEN] & np.isnan(heights)
    names, count = ndimage.label(ndimage.binary_fill_holes(high), np.ones((3, 3)))
    large = np.bincount(names.ravel(), minlength=count + 1) >= _SPECK
    large[0] = False
    return large[names]


def _measure_heap(view: FusedSurface, container: Container, region: Region, pitch: float,
                  one_side: bool) -> MeasuredStack:
    shape = tuple(int(n) for n in np.ceil((region.high - region.low)[1::-1] / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    top = view.heights(T_world_map, pitch, (shape[0], shape[1]))
    stack, seen = _standing(top.heights, one_side), np.isfinite(top.heights)
    coverage = float(seen[stack].mean()) if stack.any() else 1.0
    heights = filled(top.heights, np.ones(shape, bool))
    heights = np.where(stack, np.maximum(heights, 0.0), np.nan).astype(np.float32)
    of = _integral(heights[stack], seen[stack], pitch**2,
                   _HIDDEN_HEAP if one_side else _HIDDEN)
    inner = HeightMap(T_world_map, pitch, np.where(stack, np.float32(0), np.float32(np.nan)))
    return MeasuredStack(
        of.volume,
        _std(of, region, 0.0, _HEAP_ERROR * of.volume),
        replace(top, heights=heights),
        inner,
        coverage,
        (0.0, 0.0, 0.0),
        container,
    )
