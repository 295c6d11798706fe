# SPDX-License-Identifier: Apache-2.0
"""The filling level as JSON, under the names of `rc_reason_msgs`."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from stack_counter.types import CellFillingLevel, FillingLevel


def filling_level_as_dict(level: FillingLevel | None) -> dict[str, Any]:
    """Returns the keys of the filling level in the JSON of a count.

    Args:
        level: None where there is no container: then there are no cells, and no overall level.
    """
    if level is None:
        return {"overall_filling_level": None, "cells_filling_levels": [],
                "filling_level_cell_count": {"x": 0, "y": 0}}
    x, y = level.cell_count
    return {"overall_filling_level": _cell_as_dict(level.overall),
            "cells_filling_levels": [_cell_as_dict(cell) for cell in level.cells],
            "filling_level_cell_count": {"x": x, "y": y}}


def _cell_as_dict(cell: CellFillingLevel) -> dict[str, Any]:
    """Returns the object of a cell; numbers that there are not (NaN) are None."""
    ranges = {name: {key: None if math.isnan(value) else value
                     for key, value in dataclasses.asdict(getattr(cell, name)).items()}
              for name in ("level_in_percent", "level_free_in_meters")}
    return {"cell_size": dict(zip("xy", cell.cell_size)),
            "cell_position": dict(zip("xyz", cell.cell_position)), **ranges,
            "coverage": cell.coverage}
