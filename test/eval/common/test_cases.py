# SPDX-License-Identifier: Apache-2.0
"""The tables of `evaluate gamma` and `evaluate count`."""

import json
from dataclasses import replace

import numpy as np
import pytest
from kits.gamma_weights import KNOWING, SMALL_NET, write_gamma_weights

from stack_counter.cli import main
from stack_counter.eval import count, gamma
from stack_counter.eval.common import cases
from stack_counter.eval.common.case import Case, Guess
from stack_counter.eval.common.cases import ROWS, group_cases, ideal_volume
from stack_counter.eval.common.plot import plot_complexity
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.sim import read_scenes
from stack_counter.types import Reason


def case(i, factor=1.0, held=True, kind="bin"):
    true = 100 + 10 * i
    guess = Guess(0.5 * factor, round(true * factor), true - 5 if held else true + 1, true + 20,
                  0.01, (), "ok")
    return Case(i, f"family{i % 3}", kind, true, 0.5 + (i % 2) / 1e6, 0.2 + 0.1 * i, i / 10, 0.01,
                {row: guess for row in ROWS})


def test_a_perfect_pipeline_has_no_error():
    cases = [case(i) for i in range(8)]
    line = next(x for x in count.format_table(cases).splitlines() if x.startswith("ours  "))
    assert line.split()[1:6] == ["8", "0.000", "0.000", "0.0", "0.0"]
    assert "1.00 (0.68 to 1.00)" in line
    assert "degraded: 0 of 8 (0%)" in count.format_table(cases)


def test_degraded_counts_are_told_by_reason():
    cases = [case(i) for i in range(4)]
    ours = cases[1].guesses["ours"]
    cases[1].guesses["ours"] = replace(ours, status="degraded", reasons=(
        Reason.FEW_PARTS, Reason.SHALLOW_STACK))
    assert "degraded: 1 of 4 (25%), few_parts 1\n" in count.format_table(cases)


def test_ten_percent_too_many_and_half_of_the_intervals_missed():
    cases = [case(i, 1.1, held=i % 2 == 0) for i in range(8)]
    line = next(x for x in count.format_table(cases).splitlines() if x.startswith("ours  "))
    assert line.split()[2] == "0.101" or line.split()[2] == "0.100"
    assert "0.50 (0.22 to 0.78)" in line
    assert "family0 +10%" in count.format_table(cases)
    assert "+0.050" in gamma.format_table(cases)


def test_refused_scans_are_counted_and_not_hidden():
    refused = Case(9, "f", "bin", 10, 0.5, 0.5, 0.5, np.nan, {})
    assert count.format_table([case(0), case(1), refused]).startswith("1 refused")


def test_groups_hold_every_scene_once_by_kind_fill_and_complexity():
    cases = [case(i, kind="bin" if i % 2 else "none") for i in range(9)]
    of = group_cases(cases)
    assert sum(len(of[k]) for k in ("bin", "none")) == 9
    assert sum(len(g) for k, g in of.items() if k.startswith("fill")) == 9
    assert sum(len(of[k]) for k in ("simple", "middling", "complex")) == 9


def test_complexity_is_plotted(tmp_path):
    plot_complexity([case(i) for i in range(9)], "t", tmp_path / "c.png")
    assert (tmp_path / "c.png").read_bytes()[:4] == b"\x89PNG"


def test_the_ideal_volume_is_the_truth():
    scene = next(iter(read_scenes(find_set_folder("unseen"), 1)))
    volume = ideal_volume(scene)
    assert volume.stack_volume == scene.truth.stack_volume
    cells = volume.top.heights - volume.inner.heights
    area = volume.top.pitch**2
    assert np.nansum(np.maximum(cells, 0)) * area == pytest.approx(
        scene.truth.stack_volume, rel=0.02)


def test_the_command_prints_and_writes(tmp_path, capsys):
    out = tmp_path / "cases.json"
    assert main(["evaluate", "gamma", "--set", "unseen", "--scenes", "3", "--depth", "ideal",
                 "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "gamma of 3 scenes, ideal depth" in printed and "DepthCorrected" in printed
    cases = json.loads(out.read_text())
    assert len(cases) == 3 and set(cases[0]["guesses"]) == {
        *ROWS, "ours, size known", "ours, mesh known"}
    assert main(["evaluate", "count", "--set", "nowhere"]) == 2


def test_pictures_are_counted_without_their_depth(monkeypatch, capsys):
    """Stereo itself takes half a minute: what it is asked for stands in its place."""
    asked = []

    def reconstruct(scene, views):
        asked.append((scene.index, views))
        return ideal_volume(scene)
    monkeypatch.setattr(cases, "reconstruct_from_pictures", reconstruct)
    assert main(["evaluate", "count", "--set", "unseen", "--scenes", "3", "--depth", "pictures",
                 "--views", "24"]) == 0
    assert "of 3 scenes, pictures without depth" in capsys.readouterr().out
    assert [views for _, views in asked] == [24] * 3


def test_a_network_that_reads_the_form_is_measured_at_each_level(tmp_path, capsys):
    weights = write_gamma_weights(tmp_path / "w.safetensors",
                                  replace(SMALL_NET, knows_form=True), **KNOWING)
    assert main(["evaluate", "gamma", "--set", "unseen", "--scenes", "3", "--depth", "ideal",
                 "--weights", str(weights)]) == 0
    printed = capsys.readouterr().out
    assert "ours, size known" in printed and "ours, mesh known" in printed
