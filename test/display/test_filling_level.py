# SPDX-License-Identifier: Apache-2.0
"""What the JSON says of the filling level and of the sources of a count."""

import json
import math
from dataclasses import replace

import pytest
from kits.counted_bin import counted_bin, filling_level
from kits.result_schema import read_result

from stack_counter.display.report import as_dict, as_text
from stack_counter.types import Container, RangeValue
from stack_counter.weighing.joined_count import PieceWeight, Weighing, use_weight


def said(count):
    """The JSON of a count, which its schema allows."""
    return read_result(json.dumps(as_dict(count, [])))


def test_every_cell_has_the_names_of_rc_reason_msgs():
    result = said(counted_bin())
    assert result["filling_level_cell_count"] == {"x": 8, "y": 5}
    assert len(result["cells_filling_levels"]) == 40 and not result["overfilled"]
    cell = result["cells_filling_levels"][7]
    assert cell["cell_size"] == pytest.approx({"x": 0.0375, "y": 0.04})
    assert cell["cell_position"] == pytest.approx({"x": 0.13125, "y": -0.08, "z": 0.104})
    assert cell["level_in_percent"] == pytest.approx({"min": 87.5, "max": 100, "mean": 93.75})
    assert cell["level_free_in_meters"]["mean"] == pytest.approx(0.00625)
    assert result["overall_filling_level"]["level_in_percent"]["mean"] == 50


def test_what_there_is_not_is_null():
    level = filling_level()
    corner = replace(level.cells[0], level_in_percent=RangeValue(*[math.nan] * 3), coverage=0.0)
    cell, = said(counted_bin(filling_level=replace(level, cells=(corner,), cell_count=(1, 1)))
                 )["cells_filling_levels"]
    assert cell["level_in_percent"] == {"min": None, "max": None, "mean": None}
    heap = said(counted_bin(filling_level=None, container=Container("none", counted_bin(
        ).volume.container.T_world_container)))
    assert heap["overall_filling_level"] is None and heap["cells_filling_levels"] == []


def test_the_sources_of_a_count_are_said():
    vision = counted_bin()
    alone = said(vision)
    assert alone["net_weight_kg"] is None and "by weight" not in as_text(vision, None)
    assert [(s["source"], s["share"]) for s in alone["count_sources"]] == [("vision", 1.0)]
    joined = use_weight(vision, Weighing(1.1, 0.005), PieceWeight(0.010, 1e-4))
    result = said(joined)
    assert result["count"] == 110 and result["net_weight_kg"] == 1.1
    assert [s["count"] for s in result["count_sources"]] == [100, 110]
    assert "sources    by vision 100 (" in as_text(joined, None)
    assert "by weight 110 (108 to 112" in as_text(joined, None)
