# SPDX-License-Identifier: Apache-2.0
"""`evaluate real`: scenes with their counted truth, by the pipeline and by baselines."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from kits.nerfstudio import add_images, make_scene

from stack_counter.cli import main
from stack_counter.errors import ConfigError
from stack_counter.eval import real
from stack_counter.eval.common.real_scenes import read_real_scene
from stack_counter.picture_baselines.bmnet import BMNet, BMNetConfig
from stack_counter.picture_baselines.net_file import save_net
from stack_counter.types import PARTS


@pytest.fixture
def scene(tmp_path):
    """Three pictures; the labels show parts in a rectangle."""
    folder = make_scene(tmp_path / "hex_nut2")
    labels = np.zeros((120, 160), np.uint8)
    labels[30:80, 40:120] = PARTS
    add_images(folder, "labels", labels)
    (folder / "info.json").write_text(json.dumps(
        {"gt_count": 100, "unit_volume": 2.0, "human_guesses": [50, 150, 100]}))
    return folder


def test_a_scene_states_its_truth(scene, tmp_path):
    read = read_real_scene(scene)
    assert (read.name, read.part, read.count) == ("hex_nut2", "hex nut", 100)
    assert read.unit_volume == pytest.approx(2e-6) and read.guesses == (50, 150, 100)
    (scene / "info.json").write_text('{"gt_count": 100}')
    with pytest.raises(ConfigError, match="100 parts of 0 cm3; expected an info.json"):
        read_real_scene(scene)


def remove_labels(scene):
    for path in (scene / "labels").iterdir():
        path.unlink()
    (scene / "labels").rmdir()


def test_refusals_are_told(scene, capsys, tmp_path):
    remove_labels(scene)
    out = tmp_path / "out.json"
    assert main(["evaluate", "real", str(scene), "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "1 real scenes, 1 refused" in printed and "hex_nut2: refused: " in printed
    assert json.loads(out.read_text())[0]["count"] is None


def test_counts_are_told(scene, monkeypatch, capsys):
    monkeypatch.setattr(real, "count_bag", lambda bag, unit_volume: SimpleNamespace(
        count=90, count_interval=(70, 110), gamma=0.5, status="ok", reasons=(),
        volume=SimpleNamespace(stack_volume=90 * unit_volume / 0.5)))
    assert main(["evaluate", "real", str(scene)]) == 0
    printed = capsys.readouterr().out
    assert "NAE 0.100, SRE 0.010, MAE 10.0, sMAPE 10.5%; 1 of 1 intervals hold" in printed
    assert "hex_nut2: 90 [70, 110] for 100 (-10.0%), gamma 0.500, V 360 cm3, ok" in printed


@pytest.mark.parametrize("options", [["--pictures", "x"], ["--baseline-weights", "x"]])
def test_options_of_baselines_need_one(scene, options, capsys):
    assert main(["evaluate", "real", str(scene), *options]) == 2
    assert "--baseline" in capsys.readouterr().err


def test_people_are_those_of_the_scene_or_of_a_file(scene, tmp_path, capsys):
    assert main(["evaluate", "real", str(scene), "--baseline", "human"]) == 0
    each, together = capsys.readouterr().out.splitlines()[3:]
    assert each.split()[3:5] == ["3", "0.333"]
    assert together.split()[5:7] == ["1", "0.000"]
    path = tmp_path / "guesses.yaml"
    path.write_text("hex_nut2: 80")
    assert main(["evaluate", "real", str(scene), "--baseline", "human", "--baseline-weights",
                 str(path)]) == 0
    assert capsys.readouterr().out.splitlines()[3].split()[3:5] == ["1", "0.200"]


def test_a_baseline_sees_the_key_view_and_the_boxes(scene, tmp_path, capsys):
    assert main(["evaluate", "real", str(scene), "--baseline", "vlm"]) == 0
    assert "not run: needs WEIGHTS" in capsys.readouterr().out
    net, boxes = tmp_path / "net.safetensors", tmp_path / "boxes.yaml"
    save_net(net, "bmnet", BMNet(BMNetConfig(side_px=64, exemplar_px=32, width=16)), {})
    boxes.write_text("hex_nut2: [[5, 5, 20, 20], [30, 5, 45, 22]]")
    command = ["evaluate", "real", str(scene), "--baseline", "bmnet", "--baseline-weights",
               str(net), "--pictures", str(tmp_path / "pictures")]
    assert main(command) == 0
    assert "1 without an answer" in capsys.readouterr().out  # no exemplars
    assert main([*command, "--exemplars", str(boxes), "--json", str(tmp_path / "o.json")]) == 0
    assert json.loads((tmp_path / "o.json").read_text())[0]["guesses"][0] > 0
    height, width = cv2.imread(str(tmp_path / "pictures" / "hex_nut2.png")).shape[:2]
    assert abs(height - 50) < 6 and abs(width - 80) < 6  # the lens bends the edges a little


@pytest.mark.parametrize("text", ["[1, 2]", "a: [[1, 2, 3]]", "a: many", "a: ["])
def test_boxes_that_are_none_are_refused(tmp_path, text):
    path = tmp_path / "boxes.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match="expected boxes"):
        real.read_exemplars(path)


def test_without_labels_there_is_no_key_view(scene, tmp_path, capsys):
    remove_labels(scene)
    net = tmp_path / "net.safetensors"
    save_net(net, "bmnet", BMNet(BMNetConfig(side_px=64, exemplar_px=32, width=16)), {})
    assert main(["evaluate", "real", str(scene), "--baseline", "bmnet", "--baseline-weights",
                 str(net)]) == 0
    assert "no label image shows a part" in "".join(capsys.readouterr())
