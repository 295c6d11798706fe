# SPDX-License-Identifier: Apache-2.0
"""The command `container`: an empty bin teaches what later counts use."""

import json

import pytest
from kits.bags import bag, bin_views
from kits.command import run
from kits.tubs import stepped_box

UNIT = ["--unit-volume-cm3", "1.5"]


def test_an_empty_bin_teaches_a_container_that_replay_uses(tmp_path, capsys):
    catalogue, config = tmp_path / "containers.yaml", tmp_path / "c.yaml"
    empty, full = bag(tmp_path, bin_views(fill=0.0), "empty"), bag(tmp_path)
    code, out, _ = run(capsys, "container", "teach", "tote", empty, "--out", catalogue)
    assert code == 0 and out.startswith("tote: box, ") and "from empty)" in out
    assert run(capsys, "container", "list", catalogue)[1] == out.splitlines()[0] + "\n"
    code, _, err = run(capsys, "container", "teach", "other", full, "--out", catalogue)
    assert code == 3 and "of its capacity; expected an empty one" in err
    assert "other" not in catalogue.read_text()

    def settings(name):
        config.write_text("/stack_counter/reconstructor: {ros__parameters: {container: "
                          f"{name}, container_catalogue: {catalogue}}}}}")
        return ["--direct", "--config", config, "--json", tmp_path / "r.json"]
    assert run(capsys, "replay", full, *UNIT, *settings("tote"))[0] == 0
    result = json.loads((tmp_path / "r.json").read_text())
    assert result["container"]["inner_size_m"] == pytest.approx([0.2, 0.15, 0.1], abs=0.004)
    assert result["volume_m3"] == pytest.approx(0.2 * 0.15 * 0.05, rel=0.06)
    code, _, err = run(capsys, "replay", full, *UNIT, *settings("tub"))
    assert code == 2 and "unknown container 'tub'; expected one of ['tote']" in err
    # What is configured is not used to teach: it may be the very one to be taught.
    assert run(capsys, "container", "teach", "tub", empty, "--config", config)[0] == 0
    assert run(capsys, "replay", full, *UNIT, *settings("tub"))[0] == 0


def test_teach_says_what_it_lacks(tmp_path, capsys):
    code, _, err = run(capsys, "container", "teach", "tote", tmp_path / "none")
    assert code == 2 and "no bag" in err
    assert run(capsys, "container", "list", tmp_path / "none.yaml")[0] == 2
    nothing = tmp_path / "nothing.yaml"
    nothing.write_text("containers:\n")
    code, out, _ = run(capsys, "container", "list", nothing)
    assert code == 0 and out.startswith("no container taught yet")
    damaged = tmp_path / "damaged.yaml"
    damaged.write_text("containers: 3")
    code, _, err = run(capsys, "container", "teach", "tote", bag(tmp_path), "--out", damaged)
    assert code == 2 and "is malformed" in err and damaged.read_text() == "containers: 3"


def test_a_cad_file_teaches_a_container(tmp_path, capsys):
    mesh, catalogue = tmp_path / "tote.stl", tmp_path / "containers.yaml"
    stepped_box().solid().apply_scale(1000).export(mesh)
    code, out, _ = run(capsys, "container", "teach", "tote", "--mesh", mesh, "--out", catalogue)
    assert code == 0 and "140 mm deep, wall 3." in out and "from tote.stl, unit mm)" in out
    assert run(capsys, "container", "list", catalogue)[1] == out.splitlines()[0] + "\n"
    for more, said in ((["--unit", "m"], "its unit may be mm"), (["--up=-z"], "--up=z")):
        code, _, err = run(capsys, "container", "teach", "tub", "--mesh", mesh, "--out", catalogue,
                           *more)
        assert code == 2 and said in err and len(err.splitlines()) == 1
    assert "tub" not in catalogue.read_text()
