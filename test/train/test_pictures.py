# SPDX-License-Identifier: Apache-2.0
"""Training of the baselines that count from one picture: tiny, resumed, written and read."""

import json

import numpy as np
import pytest
from kits.disc_pictures import made_up

from stack_counter.errors import ConfigError
from stack_counter.picture_baselines import load_baseline
from stack_counter.picture_baselines.picture import Picture
from stack_counter.train import pictures
from stack_counter.train.member import read_checkpoint


@pytest.fixture
def discs(monkeypatch):
    """Eight pictures of two families; the more discs the more parts."""
    samples = [made_up(4 + 3 * k, ("nut", "tube")[k % 2]) for k in range(8)]
    monkeypatch.setattr(pictures, "load_picture_samples", lambda *_: samples)
    monkeypatch.setattr(pictures, "assign_folds", lambda families: {"nut": 1, "tube": 0})
    return samples


def train(name, out, *more):
    return pictures.main([name, "--data", "x", "--out", str(out), "--epochs", "2", "--batch", "1",
                          *more])


def ask(name, path, sample):
    picture = Picture("a", sample.color, "disc", sample.boxes.astype(float))
    return load_baseline(name, [path]).guess(picture)


def test_a_baseline_is_trained_written_and_loaded(tmp_path, discs, capsys):
    assert train("bmnet", tmp_path) == 0
    printed = capsys.readouterr().out.splitlines()
    assert json.loads(printed[-1])["mean_relative_error"] > 0
    (guess,) = ask("bmnet", tmp_path / "bmnet.safetensors", discs[0])
    assert np.isfinite(guess) and guess > 0
    history = read_checkpoint(tmp_path / "bmnet.pt")["history"]
    assert [line["epoch"] for line in history] == [0, 1]


def test_after_a_kill_it_goes_on_where_it_was(tmp_path, discs, monkeypatch):
    measure, calls = pictures.measure_held_out, []

    def killed(*args):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return measure(*args)
    monkeypatch.setattr(pictures, "measure_held_out", killed)
    with pytest.raises(KeyboardInterrupt):
        train("vit_h", tmp_path)
    first = read_checkpoint(tmp_path / "vit_h.pt")["history"]
    train("vit_h", tmp_path)
    history = read_checkpoint(tmp_path / "vit_h.pt")["history"]
    assert len(first) == 1 and len(history) == 2 and history[0] == first[0]
    assert ask("vit_h", tmp_path / "vit_h.safetensors", discs[0])[0] > 0
    # What another baseline has learnt is not gone on with.
    (tmp_path / "vit_h.pt").rename(tmp_path / "color.pt")
    with pytest.raises(ConfigError, match="name another --out"):
        train("color", tmp_path)


def test_families_of_both_sides_are_needed(discs, monkeypatch):
    monkeypatch.setattr(pictures, "assign_folds", lambda families: {"nut": 1, "tube": 1})
    with pytest.raises(ConfigError, match="8 samples to learn from and 0 of families"):
        pictures._split(discs, 0)


def test_bmnet_has_no_frozen_encoder(tmp_path, discs):
    with pytest.raises(ConfigError, match="--encoder dinov2: bmnet learns its features"):
        train("bmnet", tmp_path, "--encoder", "dinov2")
