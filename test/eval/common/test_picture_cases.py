# SPDX-License-Identifier: Apache-2.0
"""Baselines that count from one picture, behind `evaluate count`."""

import json

import pytest
import torch

from stack_counter.cli import main
from stack_counter.eval.common import picture_cases
from stack_counter.eval.common.picture_cases import PictureCase, format_baseline
from stack_counter.picture_baselines import KINDS
from stack_counter.picture_baselines.picture_net import (
    PictureNet,
    PictureNetConfig,
    save_picture_net,
)
from stack_counter.sim import picture_key_view
from stack_counter.sim.camera.recording import scaled_camera

SET = "data/train-deep"


@pytest.fixture(autouse=True)
def small_pictures(monkeypatch):
    monkeypatch.setattr(picture_cases, "picture_key_view", lambda scene, views, seed:
                        picture_key_view(scene, 2, seed, scaled_camera(160)))


def case(count, visible, *guesses):
    return PictureCase("0", "nut", "bin", count, visible, list(guesses), 0.5)


def rows(name, cases):
    return {line[:36].strip(): line[36:].split() for line in
            format_baseline(name, cases).splitlines()[3:]}


def test_errors_are_told_of_all_parts_and_of_the_visible_ones():
    by_title = rows("vlm", [case(100, 50, 50), case(300, 50, 50)])
    assert by_title["vision-language model, all parts"][:2] == ["2", "0.750"]
    assert by_title["vision-language model, visible parts"][:2] == ["2", "0.000"]


def test_no_answer_counts_nothing():
    text = format_baseline("vlm", [case(100, 50), case(100, 50, 100)])
    assert "1 without an answer, taken as 0" in text
    assert rows("vlm", [case(100, 50), case(100, 50, 100)])[
        "vision-language model, all parts"][1] == "0.500"


def test_people_err_each_and_together():
    cases = [case(100, None, 50, 150), case(200, None, 100, 300), case(7, None)]
    text, by_title = format_baseline("human", cases), rows("human", cases)
    assert "1 without a guess, left out" in text
    assert by_title["Human, all parts"][:2] == ["4", "0.500"]
    assert by_title["Human, all parts, mean guess"][:2] == ["2", "0.000"]
    assert not any("visible" in title for title in by_title)


@pytest.mark.parametrize("name", KINDS)
def test_without_weights_nothing_is_run(name, capsys):
    assert main(["evaluate", "count", "--set", SET, "--baseline", name]) == 0
    assert f"{KINDS[name].title:24}not run: needs WEIGHTS: {KINDS[name].needs[0]}" \
        in capsys.readouterr().out


@pytest.mark.parametrize("name, gives", [("vit_h", "count"), ("color", "gamma")])
def test_the_command_prints_and_writes(tmp_path, capsys, monkeypatch, name, gives):
    torch.manual_seed(0)
    path, out = tmp_path / "net.safetensors", tmp_path / "cases.json"
    net = PictureNet(PictureNetConfig(gives=gives, side_px=64)).eval()
    save_picture_net(path, name, net, {})
    if gives == "gamma":  # V is the pipeline's, which has tests of its own
        monkeypatch.setattr(picture_cases, "measure_volume",
                            lambda scene, depth, views: scene.truth)
    assert main(["evaluate", "count", "--set", SET, "--scenes", "2", "--baseline", name,
                 "--baseline-weights", str(path), "--json", str(out)]) == 0
    printed = capsys.readouterr().out
    assert "counts from one picture of 2 of 2 scenes" in printed
    assert f"{KINDS[name].title}, visible parts" in printed
    cases = json.loads(out.read_text())
    assert [c["scene"] for c in cases] == ["0", "1"]
    assert all(0 < c["visible"] <= c["count"] and len(c["guesses"]) == 1 for c in cases)


@pytest.mark.parametrize("options, said", [
    (["--baseline", "vlm", "--plot", "x.png"], "--plot are the pipeline's"),
    (["--baseline-weights", "x"], "--baseline-weights without --baseline")])
def test_options_that_would_have_no_effect_are_refused(options, said, capsys):
    assert main(["evaluate", "count", "--set", SET, *options]) == 2
    assert said in capsys.readouterr().err


def test_people_are_asked_by_the_scenes_number(tmp_path, capsys):
    path = tmp_path / "guesses.yaml"
    path.write_text("1: [20, 40]")
    assert main(["evaluate", "count", "--set", SET, "--scenes", "2", "--baseline", "human",
                 "--baseline-weights", str(path)]) == 0
    assert "Human, all parts, mean guess" in capsys.readouterr().out


def test_files_that_are_not_there_are_told_before_anything_is_rendered(tmp_path, capsys):
    assert main(["evaluate", "count", "--set", SET, "--baseline", "vlm", "--baseline-weights",
                 str(tmp_path / "none")]) == 2
    assert "no folder" in capsys.readouterr().err
