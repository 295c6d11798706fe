# SPDX-License-Identifier: Apache-2.0
"""Training of the network that finds visible parts: targets, a tiny run, resumed and written."""

import json
from dataclasses import replace
from functools import partial

import numpy as np
import pytest
import torch
from kits.cubes import cubes

from stack_counter.errors import ConfigError
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, TILE
from stack_counter.sim import parts_from_above
from stack_counter.train import visible_parts
from stack_counter.train.data.heights import make_sample
from stack_counter.train.data.part_tiles import PartSample, make_targets, make_tile
from stack_counter.train.member import TrainConfig, read_checkpoint
from stack_counter.train.part_net import KNOWN, PartNet, PartNetConfig
from stack_counter.visible_parts.decoding import COLS, MIDDLE, ROWS, SHARE, SHOWN, decode_parts
from stack_counter.visible_parts.finder import VisiblePartFinder

TINY = PartNetConfig((8, 8), (0, 0))


@pytest.fixture(scope="module")
def samples():
    """Four scenes of three cubes, one of which is half covered, of two families."""
    made = []
    for k in range(4):
        scene = cubes((-1.5, 0.3 * k, 0.5), (1, -1, 0.5), (1.5, -1, 1.5), kind="bin")
        sample = replace(make_sample(scene), family=("nut", "tube")[k % 2])
        made.append(PartSample(sample, parts_from_above(scene)))
    return made


def logits(probability):
    limited = np.clip(probability, 1e-3, 1 - 1e-3)
    return np.log(limited / (1 - limited))


def test_perfect_outputs_give_the_parts_back(samples):
    parts = samples[1].parts
    targets = make_targets(parts.numbers, parts.centers, parts.shares, samples[1].to_be_found)
    output = targets[:KNOWN].copy()
    output[[SHOWN, MIDDLE, SHARE]] = logits(output[[SHOWN, MIDDLE, SHARE]])
    found = decode_parts(output, samples[1].sample.maps.valid)
    order = [int(parts.numbers[tuple(np.round(c).astype(int))]) for c in found.centers]
    assert sorted(order) == [0, 1, 2]
    assert found.centers == pytest.approx(parts.centers[order], abs=0.01)
    assert found.shares == pytest.approx(parts.shares[order], abs=0.01)


def test_what_shows_little_is_not_to_be_found():
    numbers = np.array([[0] * 8 + [1] * 3] * 2, np.int16)
    centers = np.array([[0.5, 3.5], [0.5, 9.0]])
    targets = make_targets(numbers, centers, np.array([1.0, 0.05]), np.array([True, False]))
    assert targets[MIDDLE].max() == 1 and targets[MIDDLE][:, 8:].max() < 0.5
    assert (targets[SHOWN] == 1).all()


def test_offsets_of_a_turned_tile_lead_to_the_middles_of_the_heat_map(samples):
    for seed in range(4):
        x, targets = make_tile(samples[0], np.random.default_rng(seed))
        assert x.shape[1:] == targets.shape[1:] == (TILE, TILE)
        rows, cols = np.nonzero(targets[SHOWN] * targets[KNOWN])
        ends = np.stack([rows, cols], 1) \
            + PIXELS_PER_LENGTH * targets[[ROWS, COLS]][:, rows, cols].T
        ends = np.unique(np.round(ends).astype(int), axis=0)
        peaks = np.argwhere(targets[MIDDLE] == 1)
        assert len(peaks) == 3
        distance = np.linalg.norm(ends[:, None] - peaks[None], axis=-1).min(axis=1)
        assert distance.max() < 1.5


def prepared(monkeypatch, samples):
    monkeypatch.setattr(visible_parts, "load_part_samples", lambda *_: samples)
    monkeypatch.setattr(visible_parts, "assign_folds", lambda families: {"nut": 1, "tube": 0})
    monkeypatch.setattr(visible_parts, "PartNet", partial(PartNet, TINY))


def test_a_network_is_trained_written_and_finds_as_torch_does(tmp_path, samples, monkeypatch,
                                                              capsys):
    prepared(monkeypatch, samples)
    assert visible_parts.main(["--data", "x", "--out", str(tmp_path), "--epochs", "2",
                               "--batch", "2"]) == 0
    figures = json.loads(capsys.readouterr().out.splitlines()[-1])
    assert 0 <= figures["recall"] <= 1 and 0 <= figures["threshold"] <= 1
    history = read_checkpoint(tmp_path / "visible_parts.pt")["history"]
    assert [line["epoch"] for line in history] == [0, 1]
    # The written file gives the outputs of the network.
    net = PartNet(TINY)
    net.load_state_dict(read_checkpoint(tmp_path / "visible_parts.pt")["best"])
    finder = VisiblePartFinder(tmp_path / "visible_parts.safetensors")
    maps = torch.rand(1, 4, 48, 80)
    with torch.inference_mode():
        expected = net.eval()(maps)[0].numpy()
    assert finder._session(maps=maps.numpy())[0] == pytest.approx(expected, abs=0.02)


def test_after_a_kill_it_goes_on_where_it_was_and_learns(tmp_path, samples, monkeypatch):
    measure, calls = visible_parts.measure_held_out, []

    def killed(*args):
        calls.append(1)
        if len(calls) == 3:
            raise KeyboardInterrupt
        return measure(*args)
    monkeypatch.setattr(visible_parts, "measure_held_out", killed)
    torch.manual_seed(0)
    net, path = PartNet(TINY), tmp_path / "net.pt"
    train = partial(visible_parts.train_part_net, net, samples, samples[:1],
                    TrainConfig(epochs=8, batch=2, averaging=0.5), path)
    with pytest.raises(KeyboardInterrupt):
        train()
    first = read_checkpoint(path)["history"]
    train()
    history = read_checkpoint(path)["history"]
    assert len(first) == 2 and len(history) == 8 and history[:2] == first
    assert history[-1]["loss"] < history[0]["loss"]


def test_the_threshold_is_the_least_of_the_wanted_precision():
    scores = np.array([0.9, 0.8, 0.7, 0.6])
    right = np.array([True, True, False, False])
    figures = visible_parts._judge_scores(scores, right, np.array([True, False, False, False]), 2)
    assert figures["threshold"] == 0.8 and figures["recall"] == 0.5
    assert figures["average_precision"] == 0.5
    none = visible_parts._judge_scores(scores, ~right[::-1], right, 2)
    assert none["threshold"] == 0.8
    wrong = visible_parts._judge_scores(scores, np.zeros(4, bool), np.zeros(4, bool), 2)
    assert wrong["threshold"] == 1 and wrong["recall"] == wrong["average_precision"] == 0


def test_families_on_one_side_alone_are_refused(samples, monkeypatch):
    monkeypatch.setattr(visible_parts, "assign_folds", lambda families: {"nut": 1, "tube": 2})
    with pytest.raises(ConfigError, match="4 samples to learn from and 0 of families left out"):
        visible_parts.split_by_family(samples, 0)
