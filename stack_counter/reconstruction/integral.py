# SPDX-License-Identifier: Apache-2.0
"""Integration of fill heights into V, and V's standard deviation."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter.errors import ScanError
from stack_counter.fusion.volume_model import VolumeModel
from stack_counter.types import Container, HeightMap


@dataclass(frozen=True)
class IntegralSettings:
    """When a cell counts as holding something.

    Attributes:
        min_fill_m: fill height below which a cell counts as empty, m: what is lower is the
            noise of the fused surface; chosen.
    """

    min_fill_m: float = 0.002


SETTINGS = IntegralSettings()


@dataclass(frozen=True, eq=False)
class FillIntegral:
    """V and what its error depends on.

    Attributes:
        volume: V, m3.
        filled_in: share of V in cells that no view saw, m3.
        area: area of the cells that hold something, m2.
        fill: (n,) float fill height of every cell after the bias is taken out, m.
        beside_wall: share of V in cells that were seen beside a wall, whose height is that of
            what lies next to them, m3.
    """

    volume: float
    filled_in: float
    area: float
    fill: np.ndarray
    beside_wall: float = 0.0

    @property
    def parts(self) -> dict[str, float]:
        """What V is made of, m3, as `StackVolume.volume_parts`."""
        return {"seen": self.volume - self.filled_in - self.beside_wall,
                "filled": self.filled_in, "wall": self.beside_wall}


@dataclass(frozen=True)
class StackBoundary:
    """What bounds a stack besides its own surface, as far as V's error depends on it.

    Attributes:
        is_heap: there is no container.
        rim_length: length of the container's inner rim, m; 0 for a heap.
        opening_area: area of the rim opening, m2; of a heap's footprint.
        assumed_floor: thickness of a floor that is assumed, m; 0 where it is known or seen.
    """

    is_heap: bool
    rim_length: float
    opening_area: float
    assumed_floor: float


@dataclass(frozen=True, eq=False)
class MeasuredStack:
    """V with its standard deviation, and what it was integrated from.

    Attributes:
        integral: of the fill heights; its `volume` is V.
        stack_volume_std: standard deviation of V, m3.
        boundary: what bounds the stack besides its surface.
        top: highest surface over the footprint, unseen cells filled in from those beside them.
        inner: inner surface of the container, or the support plane below a heap.
        seen: (rows, cols) bool, the cells of the two maps that a view saw.
        below: (rows, cols) bool, those in which it saw what is below the container's wall; they
            are filled in like unseen ones.
        coverage: share of the footprint that was seen, 0 to 1.
        fill_level: 1st percentile, mean and 99th percentile of the fill, relative to the
            container's depth; zeros for a heap.
        container: with its floor as measured.
    """

    integral: FillIntegral
    stack_volume_std: float
    boundary: StackBoundary
    top: HeightMap
    inner: HeightMap
    seen: np.ndarray
    below: np.ndarray
    coverage: float
    fill_level: tuple[float, float, float]
    container: Container

    @property
    def stack_volume(self) -> float:
        """V, m3."""
        return self.integral.volume


def integrate_fill(fill: np.ndarray, seen: np.ndarray, cell_area: float, hidden_share: float,
                   worn_height_m: float, beside_wall: np.ndarray | None = None) -> FillIntegral:
    """Integrates fill heights and takes out the bias of the fused surface.

    Args:
        fill: (n,) heights of the top surface above the inner one, m, unseen cells filled in.
        seen: (n,) bool, the cells that a view saw.
        cell_area: area of a cell, m2.
        hidden_share: share of its fill that an unseen cell counts.
        worn_height_m: height that is added to every cell that holds something, m.
        beside_wall: (n,) bool, the cells whose height is not their own for a wall's sake; None
            for none.
    """
    fill = np.where(fill < SETTINGS.min_fill_m, 0.0, np.where(seen, fill, hidden_share * fill))
    fill = np.where(fill > 0, fill + worn_height_m, 0.0)
    return FillIntegral(volume=float(fill.sum()) * cell_area,
                        filled_in=float(fill[~seen].sum()) * cell_area,
                        area=np.count_nonzero(fill) * cell_area, fill=fill,
                        beside_wall=0.0 if beside_wall is None
                        else float(fill[beside_wall & seen].sum()) * cell_area)


def volume_std(integral: FillIntegral, boundary: StackBoundary, depth_noise_m: float,
               model: VolumeModel) -> float:
    """Standard deviation of V, m3: the model's independent errors added in squares.

    Args:
        integral: of the stack.
        boundary: of the stack.
        depth_noise_m: standard deviation of a depth point, m.
        model: standard deviations of each error.
    """
    if integral.volume <= 0:
        return 0.0
    if boundary.is_heap:
        wall, last = 0.0, model.heap_std * integral.volume
    else:
        wall = model.wall_std_m * boundary.rim_length * integral.volume / boundary.opening_area
        last = model.floor_std_per_wall * boundary.assumed_floor * integral.area
    level = (model.level_std_m + model.level_std_per_noise * depth_noise_m) * integral.area
    return float(np.linalg.norm([level, model.volume_std * integral.volume,
                                 model.filled_in_std * integral.filled_in, wall, last]))


def fill_unknown_cells(heights: np.ndarray, trusted: np.ndarray) -> np.ndarray:
    """Fills the cells of a height map that are unseen or not trusted in from their neighbours.

    What no view saw lies hidden below what hides it: such a cell takes the lowest of the known
    cells next to it, from the border of a hole inwards.

    Args:
        heights: (rows, cols) float, m; NaN where no view saw.
        trusted: (rows, cols) bool, the cells whose height is right where it was seen.

    Returns:
        (rows, cols) float heights, m, without NaN.

    Raises:
        ScanError: no cell is both seen and trusted.
    """
    known = np.isfinite(heights) & trusted
    if not known.any():
        raise ScanError(f"{np.count_nonzero(np.isfinite(heights))} cells of the footprint seen; "
                        "expected some: no view looks into it")
    filled = np.where(known, heights, np.inf)
    while not known.all():
        lowest = ndimage.minimum_filter(filled, 3, mode="nearest")
        reached = ~known & np.isfinite(lowest)
        filled[reached] = lowest[reached]
        known |= reached
    return filled
