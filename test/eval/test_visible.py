# SPDX-License-Identifier: Apache-2.0
"""Visible parts are measured against the simulator's truth: a rule finds cubes that lie apart."""

import json
import math

import cv2
import pytest
from kits.cubes import cubes
from kits.part_weights import SHARE_TOLD, write_part_weights

from stack_counter.cli.main import main
from stack_counter.errors import ScanError
from stack_counter.eval import visible
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.visible_parts.finder import VisiblePartFinder


@pytest.fixture(scope="module")
def finder(tmp_path_factory):
    return VisiblePartFinder(write_part_weights(tmp_path_factory.mktemp("w") / "w.safetensors"))


def test_cubes_apart_are_all_found_and_drawn(finder, tmp_path):
    scene = cubes((-1.5, 0.5, 0.5), (1, -1, 0.5), (1, 1, 0.5), kind="bin")
    case = visible.measure_scene(scene, finder, "ideal", 12, tmp_path)
    assert (case.shown, case.told, case.right, case.mostly_shown, case.found) == (3,) * 5
    assert case.share_error == pytest.approx(1 - SHARE_TOLD, abs=0.01) and case.seconds > 0
    assert (case.kind, case.count, case.refused) == ("bin", 3, "")
    assert (tmp_path / "scene_00000.png").stat().st_size > 500


def test_poses_of_the_best_cubes_are_measured_and_drawn(tmp_path):
    posing = VisiblePartFinder(write_part_weights(tmp_path / "w.safetensors"), poses=2)
    scene = cubes((-1.5, 0.5, 0.5), (1, -1, 0.5), (1, 1, 0.5), kind="bin")
    case = visible.measure_scene(scene, posing, "ideal", 12, tmp_path)
    assert len(case.poses) == 2 and all(p.error < 0.03 and p.fit > 0.7 for p in case.poses)
    picture = cv2.imread(str(tmp_path / "scene_00000.png"))
    green = (picture == visible._GREEN).all(axis=-1)
    assert 20 < green.sum()


def test_a_covered_cube_is_missed_and_one_told_beside_its_place_is_wrong(finder):
    """Two cubes in a row stand as one block of twice a side: its middle is neither's."""
    scene = cubes((-1.5, 0.5, 0.5), (-1.5, 0.5, 1.5), (0.5, 0, 0.5), (1.5, 0, 0.5), kind="bin")
    case = visible.measure_scene(scene, finder, "ideal", 12)
    assert case.shown == 3 and case.count == 4  # the one below shows nowhere
    assert case.mostly_shown == 3 and case.told >= case.right and case.found <= 3


def test_a_refused_scan_has_no_figures(finder, monkeypatch, tmp_path):
    def refuse(*_):
        raise ScanError("too few views")
    monkeypatch.setattr(visible, "measure_volume", refuse)
    case = visible.measure_scene(cubes((0, 0, 0.5)), finder, "noisy", 12)
    assert case.refused == "too few views" and math.isnan(case.seconds)
    write_figures(tmp_path / "out.json", [case])
    assert json.loads((tmp_path / "out.json").read_text())[0]["seconds"] is None


def test_the_table_sums_parts_not_scenes():
    cases = [visible.VisibleCase(0, "nut", "bin", 9, 8, 4, 3, 2, 1, 0.2, 0.01),
             visible.VisibleCase(1, "nut", "none", 9, 8, 6, 6, 6, 6, 0.1, 0.03),
             visible.VisibleCase(2, "nut", "none", 9, 8, refused="dark")]
    refused, _, total, of_bin, of_heap = visible.format_table(cases).splitlines()
    assert refused == "1 refused"
    assert total.split() == ["all", "2", "16", "10", "0.900", "8", "0.875", "0.133", "20.0"]
    assert of_bin.split()[:2] == ["bin", "1"] and of_heap.split()[:2] == ["none", "1"]


def test_weights_that_are_not_there_end_the_command_before_a_scene_is_read(tmp_path, capsys):
    missing = str(tmp_path / "missing.safetensors")
    assert main(["evaluate", "visible", "--set", "nowhere", "--weights", missing]) == 2
    assert f"no weights file {missing}" in capsys.readouterr().err
