# SPDX-License-Identifier: Apache-2.0
"""Checked values of a part catalogue's entries: ValueError says what is there and is needed."""

from __future__ import annotations

import math
from dataclasses import fields, replace
from typing import Any

from stack_counter.parts.counted_scan import CountedScan
from stack_counter.types import MeshMeasures

MOST_FRICTION = 2.0
# By how much v may be more than the box holds: sides are measured to some 2%; chosen.
_FULLEST_BOX = 1.06
_MEASURES = ("solidity", "surface_cm2", "holes", "gyration_mm")


def checked_number(value: object, key: str) -> float:
    """A finite number, 0 or more."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError):
        number = math.nan
    if not (math.isfinite(number) and number >= 0):
        raise ValueError(f"{key} {value!r} (a number, 0 or more, needed)")
    return number


def checked_friction(pair: object) -> tuple[float, float] | None:
    """Least and most friction; None where there is none."""
    if pair is None:
        return None
    if not isinstance(pair, list) or len(pair) != 2:
        raise ValueError(f"friction {pair!r} (least and most needed)")
    low, high = (checked_number(value, "friction") for value in pair)
    if not 0 < low <= high <= MOST_FRICTION:
        raise ValueError(f"friction {pair} (least and most, above 0 to {MOST_FRICTION:g}, needed)")
    return low, high


def checked_size(sides: object, unit_volume_cm3: float) -> tuple[float, float, float] | None:
    """Outer dimensions, metres, of a box that v fits into, from mm; None where there are none."""
    if sides is None:
        return None
    x, y, z = _three_lengths(sides, "size_mm")
    box_cm3 = x * y * z * 1e-3
    if unit_volume_cm3 > _FULLEST_BOX * box_cm3:
        raise ValueError(f"size_mm {sides} (a box of {box_cm3:.4g} cm3; one that holds v, "
                         f"{unit_volume_cm3:.4g} cm3, needed)")
    return x * 1e-3, y * 1e-3, z * 1e-3


def checked_measures(entry: object) -> MeshMeasures | None:
    """Measures of a mesh; None where there are none."""
    if entry is None:
        return None
    if not isinstance(entry, dict) or sorted(entry) != sorted(_MEASURES):
        raise ValueError(f"mesh_measures {entry!r} (keys {', '.join(_MEASURES)} needed)")
    solidity, surface, holes = (checked_number(entry[key], key) for key in _MEASURES[:3])
    if not (0 < solidity <= 1 and surface > 0 and holes == int(holes)):
        raise ValueError(f"mesh_measures {entry} (solidity above 0 to 1, surface above 0 and "
                         "whole holes needed)")
    x, y, z = _three_lengths(entry["gyration_mm"], "gyration_mm")
    return MeshMeasures(solidity, surface * 1e-4, int(holes), (x * 1e-3, y * 1e-3, z * 1e-3))


def measures_entry(measures: MeshMeasures) -> dict[str, Any]:
    """What `checked_measures` reads."""
    return {"solidity": float(f"{measures.solidity:.6g}"),
            "surface_cm2": float(f"{measures.surface_m2 * 1e4:.6g}"), "holes": measures.genus,
            "gyration_mm": [float(f"{1e3 * radius:.6g}") for radius in measures.gyration_m]}


def checked_scan(entry: Any) -> CountedScan:
    """A bin that was counted."""
    names = [f.name for f in fields(CountedScan)]
    if not isinstance(entry, dict) or sorted(entry) != sorted(names):
        raise ValueError(f"counted {entry} (keys {', '.join(names)} needed)")
    scan = CountedScan(**entry)
    return replace(scan, inner_size_m=tuple(float(x) for x in scan.inner_size_m)).checked()


def _three_lengths(values: object, key: str) -> tuple[float, float, float]:
    if not isinstance(values, list) or len(values) != 3:
        raise ValueError(f"{key} {values!r} (three numbers needed)")
    x, y, z = (checked_number(value, key) for value in values)
    if not min(x, y, z) > 0:
        raise ValueError(f"{key} {values} (three numbers above 0 needed)")
    return x, y, z
