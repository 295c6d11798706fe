# SPDX-License-Identifier: Apache-2.0
"""Checked values of a part catalogue's entries: ValueError says what is there and is needed."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from typing import Any

from stack_counter.parts.counted_scan import CountedScan
from stack_counter.types import MeshMeasures
from stack_counter.weighing.joined_count import REFERENCE_PIECES, PieceWeight
from stack_counter.weighing.joined_count import SETTINGS as WEIGHING

MOST_FRICTION = 2.0
# v over the box of the outer dimensions: sides are measured to some 2%, and the emptiest wire
# frames that networks learn from fill 1%; chosen.
_BOX_SHARES = (0.002, 1.06)
_PIECE_WEIGHT = ("piece_weight_g", "piece_weight_sd_g", "piece_weight_pieces")
_MEASURES = ("solidity", "surface_cm2", "holes", "gyration_mm")


def checked_number(value: object, key: str) -> float:
    """A finite number, 0 or more."""
    try:
        number = math.nan if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
    except (TypeError, ValueError, OverflowError):
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
    """Outer dimensions, metres, from mm; None where there are none."""
    if sides is None:
        return None
    x, y, z = _three_lengths(sides, "size_mm")
    return check_outer_size((x * 1e-3, y * 1e-3, z * 1e-3), unit_volume_cm3 * 1e-6)


def check_outer_size(sides_m: Sequence[float], unit_volume: float) -> tuple[float, float, float]:
    """The sides of the box around a part, metres, if v (m3) can be that of what is in it."""
    text = " x ".join(f"{1e3 * side:.6g}" for side in sides_m) + " mm"
    if len(sides_m) != 3 or not all(math.isfinite(side) and side > 0 for side in sides_m):
        raise ValueError(f"outer dimensions {text} (three finite lengths above 0 needed)")
    x, y, z = sides_m
    least, most = (unit_volume / share for share in reversed(_BOX_SHARES))
    if not least <= x * y * z <= most:
        raise ValueError(f"outer dimensions {text}, a box of {x * y * z * 1e6:.4g} cm3 (one of "
                         f"{least * 1e6:.4g} to {most * 1e6:.4g} cm3 needed, as v is "
                         f"{unit_volume * 1e6:.4g} cm3)")
    return x, y, z


def checked_measures(entry: object) -> MeshMeasures | None:
    """Measures of a mesh; None where there are none."""
    if entry is None:
        return None
    if not isinstance(entry, dict) or set(entry) != set(_MEASURES):
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


def checked_piece_weight(entry: Mapping[str, Any]) -> PieceWeight | None:
    """The weight of a piece, kg, from the keys of a part's entry; None where there is none."""
    mean, std, pieces = (None if entry.get(key) is None else checked_number(entry[key], key)
                         for key in _PIECE_WEIGHT)
    if mean is None:
        if std is not None or pieces is not None:
            raise ValueError(f"{_PIECE_WEIGHT[1]} or {_PIECE_WEIGHT[2]} without {_PIECE_WEIGHT[0]}"
                             " (the mean needed)")
        return None
    pieces = REFERENCE_PIECES if pieces is None else pieces
    if not (mean > 0 and pieces >= 1 and pieces == int(pieces)):
        raise ValueError(f"{_PIECE_WEIGHT[0]} {mean:g} of {pieces:g} pieces (a weight above 0 and "
                         "a whole number of 1 or more needed)")
    share = WEIGHING.piece_std_share if std is None else std / mean
    return PieceWeight(mean * 1e-3, share * mean * 1e-3, int(pieces))


def piece_weight_entry(piece: PieceWeight) -> dict[str, Any]:
    """What `checked_piece_weight` reads."""
    grams = (float(f"{1e3 * kg:.9g}") for kg in (piece.mean_kg, piece.std_kg))
    return dict(zip(_PIECE_WEIGHT, (*grams, piece.pieces)))


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
