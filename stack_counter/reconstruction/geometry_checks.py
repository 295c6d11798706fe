# SPDX-License-Identifier: Apache-2.0
"""Whether a measured stack can be what it is taken for: its geometry checks itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter.reconstruction.integral import MeasuredStack
from stack_counter.types import Reason


@dataclass(frozen=True)
class GeometryCheckSettings:
    """From when on a stack contradicts itself.

    Measured on 40 recordings of train-shallow and train-deep, and on 200 heaps of the training
    sets seen ideally.

    Attributes:
        wall_cells: cells next to a wall, in which the fused surface is the wall's; chosen.
        below_floor_m: depth below the claimed floor, m, at which a surface contradicts it; chosen.
        max_below_floor: largest share of the opening in which it may: at most 0.06 where the count
            was right, and 0.11, 0.29 and 0.50 in three of the five where it was wrong.
        max_inferred: largest share of V that may lie where no view saw: at most 0.09 in all.
        border_lengths: width of a heap's border strip, part lengths; chosen.
        steep_lengths: height above which that strip is a cliff, part lengths; chosen.
        max_steep: largest share of the strip that may be: at most 0.11 in all.
        above_rim_lengths: height above the rim, part lengths, from which what lies in a container
            is taken to slope by at most 45 degrees from its wall on; chosen.
        max_above_slope: largest share of V that may stand higher: at most 0.0001 in 26 heaped
            containers of the training sets, 0.06 and more in seven with a robot's arm over them,
            of which half of the parts or fewer were counted.
        max_noise_lengths: largest standard deviation of a depth point, part lengths: above it the
            counts of both were wrong, below it of three in 38.
    """

    wall_cells: float = 2.5
    below_floor_m: float = 0.005
    max_below_floor: float = 0.08
    max_inferred: float = 0.25
    border_lengths: float = 0.75
    steep_lengths: float = 3.0
    max_steep: float = 0.2
    above_rim_lengths: float = 2.0
    max_above_slope: float = 0.03
    max_noise_lengths: float = 0.35


SETTINGS = GeometryCheckSettings()


def check_geometry(stack: MeasuredStack, depth_noise_m: float, unit_volume: float
                   ) -> tuple[Reason, ...]:
    """Lists in which ways a measured stack contradicts itself, or cannot be known well.

    Args:
        stack: as measured.
        depth_noise_m: standard deviation of a depth point, m.
        unit_volume: volume of one part, m3; 0 where it is not known.
    """
    is_heap, part_length = stack.container.kind == "none", unit_volume ** (1 / 3)
    holds = {
        Reason.BELOW_FLOOR: not is_heap
        and _share_below_floor(stack) > SETTINGS.max_below_floor,
        Reason.MOSTLY_INFERRED: stack.integral.filled_in
        > SETTINGS.max_inferred * stack.stack_volume,
        Reason.STEEP_HEAP: unit_volume > 0 and (
            _steep_share(stack, part_length) > SETTINGS.max_steep if is_heap else
            _share_above_slope(stack, part_length) > SETTINGS.max_above_slope),
        Reason.NOISY_DEPTH: unit_volume > 0
        and depth_noise_m > SETTINGS.max_noise_lengths * part_length,
    }
    return tuple(reason for reason, is_so in holds.items() if is_so)


def _share_below_floor(stack: MeasuredStack) -> float:
    """Share of the opening's seen cells whose surface lies below the container's own."""
    fill = stack.top.heights - stack.inner.heights
    known = np.isfinite(fill) & stack.seen \
        & (_cells_to_border(np.isfinite(fill)) > SETTINGS.wall_cells)
    if not known.any():
        return 0.0
    return float(np.mean((fill < -SETTINGS.below_floor_m)[known] | stack.below[known]))


def _steep_share(stack: MeasuredStack, part_length: float) -> float:
    """Share of a heap's border strip that is higher than loose parts stand there."""
    heights = stack.top.heights
    footprint = np.isfinite(heights)
    strip = footprint & (_cells_to_border(footprint) * stack.top.pitch
                         <= SETTINGS.border_lengths * part_length)
    if not strip.any():
        return 0.0
    return float(np.mean(heights[strip] > SETTINGS.steep_lengths * part_length))


def _share_above_slope(stack: MeasuredStack, part_length: float) -> float:
    """Share of V that stands higher above a container's rim than loose parts can."""
    inside = np.isfinite(stack.top.heights) & np.isfinite(stack.inner.heights)
    depth = stack.container.inner_size_m[2]
    if not (depth > 0 and stack.stack_volume > 0 and inside.any()):
        return 0.0
    rim = stack.inner.heights[inside].min() + depth
    slope = rim + SETTINGS.above_rim_lengths * part_length \
        + _cells_to_border(inside) * stack.top.pitch
    above = np.maximum(stack.top.heights - slope, 0)[inside]
    return float(above.sum()) * stack.top.pitch**2 / stack.stack_volume


def _cells_to_border(cells: np.ndarray) -> np.ndarray:
    """Distance of each of (rows, cols) bool cells from the nearest that is not set, cells."""
    return ndimage.distance_transform_edt(np.pad(cells, 1))[1:-1, 1:-1]
