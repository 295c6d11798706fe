# SPDX-License-Identifier: Apache-2.0
"""The command `part`: from a mesh to a corrected count, and what it refuses."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import pytest
import trimesh
import yaml
from kits.bags import bag, bin_views
from kits.command import run
from kits.known_parts import COUNTED, gamma_model

from stack_counter.parts.catalogue import Part, load_parts, save_part
from stack_counter.parts.part_models import PartModels
from stack_counter.teaching import model_fit

BLOCK = trimesh.creation.box((30.0, 20.0, 20.0))


@pytest.fixture
def catalogue(tmp_path):
    path = tmp_path / "parts.yaml"
    save_part(Part(1.5e-6, "nut", density=2700.0), path)
    return path


def part(capsys, what, *arguments):
    return run(capsys, "part", what, *arguments)


def test_a_counted_bin_corrects_the_next_count_and_can_be_undone(tmp_path, capsys, catalogue):
    at, path = ("--catalogue", catalogue), bag(tmp_path)

    def count():
        out = tmp_path / "r.json"
        assert run(capsys, "replay", path, "--part", "nut", *at, "--direct", "--json", out)[0] == 0
        return json.loads(out.read_text())

    before = count()
    assert before["gamma_shares"] == {"estimator": 1.0} and before["counted_scans"] == 0
    true = round(1.2 * before["count"])
    code, text, _ = part(capsys, "calibrate", "nut", path, "--count", true, *at)
    assert code == 0 and f"would have been {before['count']}" in text
    after = count()
    assert after["counted_scans"] == 1 and after["gamma_shares"]["counted"] > 0.2
    assert before["count"] < after["count"] <= true
    weight = f"{after['count'] * 1.5e-6 * 2700:.6f}"
    assert part(capsys, "calibrate", "nut", path, "--weight", weight, *at, "--force")[0] == 0
    assert [scan.count for scan in load_parts(catalogue)["nut"].counted] == [true, after["count"]]
    for left in (1, 0):
        code, text, _ = part(capsys, "calibrate", "nut", "--undo", *at)
        assert code == 0 and f"counted bins left: {left}" in text
    assert count() == {**before, "seconds": pytest.approx(before["seconds"], abs=100)}
    code, _, error = part(capsys, "calibrate", "nut", "--undo", *at)
    assert code == 2 and "no counted bin" in error


def test_a_drift_is_warned_of(tmp_path, capsys, catalogue):
    path = bag(tmp_path)
    for _ in range(3):
        assert part(capsys, "calibrate", "nut", path, "--count", 500, "--catalogue", catalogue,
                    "--force")[0] == 0
    code, _, warning = part(capsys, "calibrate", "nut", path, "--count", 900, "--catalogue",
                            catalogue, "--force")
    assert code == 0 and "standard deviations off the counted bins before (3)" in warning


@pytest.mark.parametrize("arguments, what", [
    (["--count", "0"], "0 parts counted"), (["--count", "9000"], "9000 parts counted"),
    (["--weight", "0.5", "--piece-weight", "0.05"], "10000 parts counted")])
def test_implausible_counts_are_refused(tmp_path, capsys, catalogue, arguments, what):
    code, _, error = part(capsys, "calibrate", "nut", bag(tmp_path), *arguments, "--catalogue",
                          catalogue)
    assert code == 2 and what in error and "estimated; expected" in error
    assert load_parts(catalogue)["nut"].counted == ()


def test_several_cycles_are_no_counted_bin(capsys, catalogue, monkeypatch):
    root = Path(__file__).parents[2]
    monkeypatch.chdir(root)  # the settings name the rig file from there
    code, _, error = part(capsys, "calibrate", "nut", "bags/station", "--config",
                          "config/station.yaml", "--count", "100", "--catalogue", catalogue)
    assert code == 3 and "holds 5 cycles that give a volume; expected one" in error


def test_another_rig_is_refused(tmp_path, capsys, catalogue):
    save_part(Part(1.5e-6, "nut", counted=(COUNTED,)), catalogue)
    code, _, error = part(capsys, "calibrate", "nut", bag(tmp_path), "--count", "500",
                          "--catalogue", catalogue)
    assert code == 2 and "expected about 300 x 200 x 100 mm" in error


def test_names_and_paths_that_are_not_there(tmp_path, capsys, catalogue):
    at = ("--catalogue", catalogue)
    assert "expected one of ['nut']" in part(capsys, "calibrate", "bolt", "x", "--count", "5",
                                             *at)[2]
    assert "no bag" in part(capsys, "calibrate", "nut", "x", "--count", "5", *at)[2]
    assert "no bag" in part(capsys, "template", "bolt", "x", "--pieces", "5", *at)[2]
    assert "expected 1 or more" in part(capsys, "template", "bolt", "x", "--pieces", "0", *at)[2]
    assert "no mesh" in part(capsys, "add", "bolt", "--mesh", "x.stl", *at)[2]
    assert "unknown part" in part(capsys, "remove", "bolt", *at)[2]
    assert part(capsys, "remove", "nut", *at)[0] == 0 and load_parts(catalogue) == {}


def test_a_mesh_of_another_volume_does_not_silently_forget_counted_bins(tmp_path, capsys,
                                                                        catalogue):
    save_part(Part(1.5e-6, "nut", counted=(COUNTED,)), catalogue)
    BLOCK.export(tmp_path / "block.stl")
    code, _, error = part(capsys, "add", "nut", "--mesh", tmp_path / "block.stl", "--catalogue",
                          catalogue)
    assert code == 2 and "v 1.5 cm3; expected about that, not 12 cm3" in error
    assert load_parts(catalogue)["nut"].counted == (COUNTED,)


def test_a_part_from_its_mesh(tmp_path, capsys, monkeypatch):
    """Real piles, fewer than a user may ask for; the catalogue gets all that a count needs."""
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    BLOCK.export(tmp_path / "block.stl")
    rig = {"/stack_counter/reconstructor": {"ros__parameters": {
        "container_kind": "box", "container_inner_size_m": [0.13, 0.1, 0.06]}},
        "/stack_counter/counter": {"ros__parameters": {"part_catalogue": str(
            tmp_path / "parts.yaml")}}}
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump(rig))
    monkeypatch.setattr("stack_counter.cli.part_commands._LEAST_PILES", 6)
    monkeypatch.setattr(model_fit, "SETTINGS", replace(model_fit.SETTINGS, min_piles=5))
    code, text, _ = part(capsys, "add", "block", "--mesh", tmp_path / "block.stl", "--config",
                         tmp_path / "rig.yaml", "--piles", "6", "--workers", "1",
                         "--density", "1.2")
    assert code == 0 and "v 12 cm3" in text and "bin of 130 x 100 x 60 mm" in text
    block = load_parts(tmp_path / "parts.yaml")["block"]
    assert block.unit_volume == pytest.approx(12e-6) and block.density == 1200
    gamma, std = block.models.arc.gamma_at(2.0, 5.0)
    # Blocks of friction 0.05 lie half as dense again as those of 0.6.
    assert 0.45 < gamma < 0.75 and std / gamma < 0.2
    assert (tmp_path / "parts" / "block.stl").is_file()
    code, text, _ = part(capsys, "list", "--catalogue", tmp_path / "parts.yaml")
    assert "6 simulated piles" in text
    shutil.rmtree(tmp_path / "parts")
    (tmp_path / "parts.yaml").touch()  # a process that has read both keeps them until then
    code, _, error = run(capsys, "replay", "x", "--part", "block", "--catalogue",
                         tmp_path / "parts.yaml")
    assert code == 2 and "no gamma prior" in error


def test_a_mesh_is_measured_at_once_without_piles(tmp_path, capsys):
    BLOCK.export(tmp_path / "block.stl")
    arguments = ["add", "block", "--mesh", tmp_path / "block.stl", "--catalogue",
                 tmp_path / "parts.yaml", "--piles", "0"]
    code, text, _ = part(capsys, *arguments)
    assert code == 0 and "v 12 cm3" in text
    block = load_parts(tmp_path / "parts.yaml")["block"]
    assert sorted(block.outer_size_m) == pytest.approx(sorted(BLOCK.extents / 1e3))
    assert block.mesh_measures.solidity == pytest.approx(1) and block.models is None
    code, text, _ = part(capsys, "list", "--catalogue", tmp_path / "parts.yaml")
    assert " mm; form of its mesh; counted bins: 0" in text
    code, _, error = part(capsys, *arguments, "--tune")
    assert code == 2 and "--tune with --piles 0" in error


def test_a_wrong_part_in_the_bin_is_told(tmp_path, capsys, catalogue):
    """The piles say 0.6, the network something else by far, and the answer says so."""
    from stack_counter.config import CounterConfig
    from stack_counter.occupancy import make_estimator

    models = PartModels(
        make_estimator(CounterConfig()).name, gamma_model(said=0.01), gamma_model(), "piles"
    )
    models.write(tmp_path / "nut.json")
    save_part(Part(1.5e-6, "nut", gamma_prior=tmp_path / "nut.json"), catalogue)
    code, text, _ = run(capsys, "replay", bag(tmp_path, bin_views()), "--part", "nut", "--direct",
                        "--catalogue", catalogue)
    assert code == 0 and "degraded" in text and "part_disagrees" in text
