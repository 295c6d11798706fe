# SPDX-License-Identifier: Apache-2.0
"""The filling level of a container over a grid on its floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.reconstruction.integral import MeasuredStack
from stack_counter.types import CellFillingLevel, FillingLevel, HeightMap, RangeValue


@dataclass(frozen=True)
class FillingLevelSettings:
    """Which places of a cell say its level; all chosen.

    Attributes:
        over_floor: height from the inner surface to the rim, relative to the container's, from
            which a place lies over the floor; a cell that has such places leaves out its others,
            where a wall leans in.
        deepest_wall: the same for the places that say the level of a cell without a floor.
        percentile: of the values that count as the least; the largest is as far from the end.
    """

    over_floor: float = 0.9
    deepest_wall: float = 0.1
    percentile: float = 1.0


SETTINGS = FillingLevelSettings()


def measure_filling_level(stack: MeasuredStack, cells: int) -> FillingLevel | None:
    """Returns the filling level; None where there is no container (a heap).

    Args:
        stack: as measured; its maps lie along the container's axes.
        cells: along the longer side of the opening; they are as square as can be.
    """
    depth = stack.container.inner_size_m[2]
    opening = np.isfinite(stack.top.heights)
    if not depth or not opening.any():
        return None
    rim = stack.container.floor_thickness_m + depth
    fill = np.zeros(opening.shape)
    fill[opening] = stack.integral.fill
    room = np.where(opening, rim - stack.inner.heights, 0.0)  # from the inner surface to the rim
    seen = stack.seen & ~stack.below
    # Divide the map into cells; keep the places that say their level.
    shape = np.array(opening.shape)
    count = np.clip(np.round(cells * shape / shape.max()), 1, shape)
    rows, cols = (np.linspace(0, size, int(n) + 1).round().astype(int)
                  for size, n in zip(opening.shape, count))
    used, grid = np.zeros_like(opening), []
    for low_row, high_row in zip(rows[:-1], rows[1:]):
        for low_col, high_col in zip(cols[:-1], cols[1:]):
            window = (slice(low_row, high_row), slice(low_col, high_col))
            used[window] = _places_of_level(room[window], depth)
            grid.append(_cell(window, used, fill, room, seen, stack.inner, rim))
    whole = (slice(0, opening.shape[0]), slice(0, opening.shape[1]))
    return FillingLevel(_cell(whole, used, fill, room, seen, stack.inner, rim), tuple(grid),
                        (len(cols) - 1, len(rows) - 1))


def _places_of_level(room: np.ndarray, depth: float) -> np.ndarray:
    """Returns which places of a cell say its level: (rows, cols) bool.

    Args:
        room: (rows, cols) m, from the inner surface to the rim; 0 outside the opening.
        depth: the container's inner height, m.
    """
    over_floor = room > SETTINGS.over_floor * depth
    return over_floor if over_floor.any() else room > SETTINGS.deepest_wall * depth


def _cell(window: tuple[slice, slice], used: np.ndarray, fill: np.ndarray, room: np.ndarray,
          seen: np.ndarray, inner: HeightMap, rim: float) -> CellFillingLevel:
    """Returns the level of a window of the maps, all (rows, cols), m; `rim`: its height, m."""
    places = used[window]
    filled, available = fill[window][places], room[window][places]
    (top, bottom), (left, right) = ((part.start, part.stop) for part in window)
    middle = np.array([[(left + right) / 2 * inner.pitch, (top + bottom) / 2 * inner.pitch, rim]])
    x, y, z = geometry.apply(inner.T_world_map, middle)[0].tolist()
    return CellFillingLevel(
        cell_size=((right - left) * inner.pitch, (bottom - top) * inner.pitch),
        cell_position=(x, y, z),
        level_in_percent=_range(100 * filled / available),
        level_free_in_meters=_range(available - filled),
        coverage=float(seen[window][places].mean()) if places.any() else 0.0)


def _range(values: np.ndarray) -> RangeValue:
    """Returns the range of (n,) values; NaN of none."""
    if not len(values):
        return RangeValue(math.nan, math.nan, math.nan)
    low, high = np.percentile(values, [SETTINGS.percentile, 100 - SETTINGS.percentile])
    return RangeValue(float(low), float(high), float(values.mean()))
