# SPDX-License-Identifier: Apache-2.0
"""How full a container is, as a whole and over a grid on its floor.

Fields have the names of the messages of `rc_reason_msgs` (`LoadCarrierWithFillingLevel`,
`CellFillingLevel`, `RangeValue`, `GridSize`), so that who reads those reads these.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class RangeValue:
    """First percentile, 99th percentile and mean of many values; NaN where there are none."""

    min: float
    max: float
    mean: float


@dataclass(frozen=True)
class CellFillingLevel:
    """How full one cell of a container is.

    Attributes:
        cell_size: along the container's x and y, metres.
        cell_position: centre of the cell at the height of the rim, world, metres.
        level_in_percent: filled share of the height from the inner surface up to the rim: 0 is
            empty, 100 full, above 100 over the rim; NaN for a cell beside the opening.
        level_free_in_meters: from the surface up to the rim; negative over the rim.
        coverage: share of the cell that some view saw, 0 to 1; the level of the rest is inferred.
    """

    cell_size: tuple[float, float]
    cell_position: tuple[float, float, float]
    level_in_percent: RangeValue
    level_free_in_meters: RangeValue
    coverage: float


@dataclass(frozen=True)
class FillingLevel:
    """How full a container is.

    Attributes:
        overall: the whole opening as one cell.
        cells: along the container's x first, then along its y.
        cell_count: number of cells along the container's x and y.
    """

    overall: CellFillingLevel
    cells: tuple[CellFillingLevel, ...]
    cell_count: tuple[int, int]
