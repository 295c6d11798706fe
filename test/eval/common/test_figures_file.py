# SPDX-License-Identifier: Apache-2.0
"""The JSON of evaluations, and docs/json.md about it."""

import json
import re
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np
import pytest

from stack_counter.eval.benchmark import BenchmarkRow
from stack_counter.eval.common.band_power import BandPower
from stack_counter.eval.common.case import Case, Guess
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.part_table import PartCount
from stack_counter.eval.common.picture_cases import PictureCase
from stack_counter.eval.images import DepthErrors, PictureErrors
from stack_counter.eval.live import LiveCount
from stack_counter.eval.real import RealCase
from stack_counter.eval.robustness import Outcome
from stack_counter.eval.surface import SurfaceCase
from stack_counter.eval.volume import VolumeCase
from stack_counter.eval.weight import WeighedScan
from stack_counter.types import Reason

PAGE = (Path(__file__).parents[3] / "docs" / "json.md").read_text()
TABLE = [[cell.strip() for cell in line.strip("|").split(" | ")]
         for line in PAGE.split("## Files of long work")[0].splitlines() if line.startswith("| `")]


@dataclass
class Inner:
    share: float
    reasons: tuple[Reason, ...] = (Reason.FEW_PARTS,)


@dataclass
class Outer:
    inner: dict[str, Inner]


def refuse(constant):
    raise AssertionError(f"{constant} is no JSON")


def test_numbers_that_there_are_not_are_null(tmp_path):
    path = tmp_path / "out.json"
    write_figures(path, [Outer({"a": Inner(np.nan), "b": Inner(0.5)})])
    few = str(Reason.FEW_PARTS.value)
    assert json.loads(path.read_text(), parse_constant=refuse) == [{"inner": {
        "a": {"share": None, "reasons": [few]}, "b": {"share": 0.5, "reasons": [few]}}}]


@pytest.mark.parametrize("kind, row", [
    ("count", Case), ("volume", VolumeCase), ("live", LiveCount), ("robustness", Outcome),
    ("parts", PartCount), ("images", PictureErrors), ("images", DepthErrors),
    ("benchmark", BenchmarkRow), ("surface", SurfaceCase), ("surface", BandPower),
    ("weight", WeighedScan), ("count", PictureCase), ("real", PictureCase), ("real", RealCase)])
def test_the_page_names_every_key(kind, row):
    cells = [cells[2] for cells in TABLE if f"`{kind}`" in cells[0] and "summary" not in cells[1]]
    assert {field.name for field in fields(row)} <= set(re.findall(r"`(\w+)`", " ".join(cells)))


def test_the_page_names_the_keys_of_a_guess():
    sentence = PAGE[PAGE.index("A guess has"):].split("\n")[0]
    assert re.findall(r"`(\w+)`", sentence) == [field.name for field in fields(Guess)]
