# SPDX-License-Identifier: Apache-2.0
"""Which solids `part add` takes: the figures of known outcomes."""

import json
from dataclasses import asdict, replace

import numpy as np
import pytest
from kits.collections import make_collection

from stack_counter.cli.main import main
from stack_counter.eval.acceptance import PartCheck, check_part, format_table
from stack_counter.sim import open_library


def test_the_figures_of_three_solids():
    table = format_table([
        PartCheck(0, "a", 8, 10, 1.2, 0.01, 1.0, 40.0, 8, {"unsettled": 25}),
        PartCheck(1, "b", 8, 24, 1.5, 0.03, 2.0, 80.0, 8, {"unsettled": 20, "penetration": 6}),
        PartCheck(2, "c", 8, refused="c: no solid")])
    assert "1 of 3 solids taken (33.3%), 1 refused" in table
    assert "51 for 16 piles, 26 at most for a solid; 45 unsettled, 6 penetration" in table
    assert "fullness: median 1.35, 95% 1.48, most 1.5" in table


def test_the_pieces_of_a_solid_and_one_that_is_none(tmp_path, monkeypatch):
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    make_collection(tmp_path / "solids.npz")
    library = open_library(tmp_path / "solids.npz")
    check = check_part(library, 0, piles=0)
    assert check.taken and check.pieces == 1 and check.failed == 0
    assert check.fullness == pytest.approx(1, abs=1e-3)
    assert check_part([library[0]], 0, piles=0).family == "BrickYard/Brick"


def test_solids_that_are_written_are_not_tried_again(tmp_path, capsys):
    make_collection(tmp_path / "solids.npz")
    written = PartCheck(0, "written before", 0, 7, 1.5, 0.03, 2.0, 80.0, 8, {"unsettled": 20})
    of_other_piles = replace(written, asked=3, pieces=9)
    (tmp_path / "checks.json").write_text(json.dumps([asdict(written), asdict(of_other_piles)]))
    arguments = ["evaluate", "acceptance", "--library", str(tmp_path / "solids.npz"),
                 "--solids", "1", "--piles", "0", "--json", str(tmp_path / "checks.json")]
    library = open_library(tmp_path / "solids.npz")
    seed = next(seed for seed in range(99)
                if np.random.default_rng(seed).permutation(len(library))[0] == written.number)
    assert main([*arguments, "--seed", str(seed)]) == 0
    out = capsys.readouterr().out
    assert "1 of 1 solids taken" in out and "pieces: median 7" in out
