# SPDX-License-Identifier: Apache-2.0
"""V of a heap: the integral between the support plane and the highest surface."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import volume_model
from stack_counter.reconstruction.integral import SETTINGS as INTEGRAL_SETTINGS
from stack_counter.reconstruction.integral import (
    MeasuredStack,
    StackBoundary,
    fill_unknown_cells,
    integrate_fill,
    volume_std,
)
from stack_counter.types import Container, HeightMap


@dataclass(frozen=True)
class HeapSettings:
    """What stands on the support plane and belongs to a heap.

    Attributes:
        plane_band_m: distance from the support plane within which its own surface is looked
            for, m; chosen.
        noise_factor: how many standard deviations of the plane's own surface something must
            stand above it; chosen.
        min_cells: area below which something is noise and no part, cells; chosen.
        gap_radius_cells: half the widest gap between parts, unseen from one side, that is
            counted to the heap, cells; chosen.
    """

    plane_band_m: float = 0.006
    noise_factor: float = 4
    min_cells: int = 6
    gap_radius_cells: int = 8


SETTINGS = HeapSettings()


def measure_heap(surface: FusedSurface, container: Container, region: Region, pitch: float,
                 one_side: bool) -> MeasuredStack:
    """Integrates a heap over its footprint on the support plane.

    Args:
        surface: fused surface, world frame.
        container: of kind `none`.
        region: where the heap is looked for; its `plane_z` is the support plane.
        pitch: side of a map cell, m.
        one_side: all views come from one side, as those of a single fixed camera.

    Raises:
        ScanError: no view saw anything of the region.
    """
    model = volume_model()
    # Map the highest surface over the region.
    shape = tuple(int(n) for n in np.ceil((region.high - region.low)[1::-1] / pitch))
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    top = surface.heights(T_world_map, pitch, (shape[0], shape[1]))
    # Segment the heap's footprint.
    footprint, seen = find_footprint(top.heights, one_side), np.isfinite(top.heights)
    coverage = float(seen[footprint].mean()) if footprint.any() else 1.0
    # Fill unseen cells in, and integrate.
    heights = fill_unknown_cells(top.heights, np.ones(shape, bool))
    heights = np.where(footprint, np.maximum(heights, 0.0), np.nan).astype(np.float32)
    hidden_share = model.hidden_share_one_side_heap if one_side else model.hidden_share
    integral = integrate_fill(heights[footprint], seen[footprint], pitch**2, hidden_share,
                              model.worn_height_m)
    boundary = StackBoundary(is_heap=True, rim_length=0.0,
                             opening_area=np.count_nonzero(footprint) * pitch**2,
                             assumed_floor=0.0)
    inner = np.where(footprint, np.float32(0), np.float32(np.nan))
    return MeasuredStack(
        integral=integral, stack_volume_std=volume_std(integral, boundary, region.noise, model),
        boundary=boundary, top=replace(top, heights=heights),
        inner=HeightMap(T_world_map, pitch, inner), seen=seen,
        below=np.zeros_like(seen), coverage=coverage,
        fill_level=(0.0, 0.0, 0.0), container=container)


def find_footprint(heights: np.ndarray, one_side: bool) -> np.ndarray:
    """Segments the cells of a heap, unseen ones between its parts included, without specks.

    Args:
        heights: (rows, cols) float, m above the support plane; NaN where no view saw.
        one_side: all views come from one side: unseen cells in gaps between parts count too.

    Returns:
        (rows, cols) bool.
    """
    # Threshold above the noise of the support plane's own surface.
    known = heights[np.isfinite(heights)]
    plane = known[np.abs(known) < SETTINGS.plane_band_m]
    noise = 1.4826 * float(np.median(np.abs(plane))) if len(plane) else 0.0
    lowest = max(INTEGRAL_SETTINGS.min_fill_m, SETTINGS.noise_factor * noise)
    high = np.nan_to_num(heights, nan=0.0) > lowest
    # Close unseen gaps between parts.
    if one_side:
        radius = SETTINGS.gap_radius_cells
        disc = np.hypot(*np.mgrid[-radius:radius + 1, -radius:radius + 1]) <= radius
        closed = ndimage.binary_closing(np.pad(high, radius), disc)
        high |= closed[radius:-radius, radius:-radius] & np.isnan(heights)
    # Fill holes and drop components that are too small for a part.
    labels, count = ndimage.label(ndimage.binary_fill_holes(high), np.ones((3, 3)))
    large = np.bincount(labels.ravel(), minlength=count + 1) >= SETTINGS.min_cells
    large[0] = False
    return large[labels]
