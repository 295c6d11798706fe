# SPDX-License-Identifier: Apache-2.0
"""The baseline that counts straight from the picture: sees no part size, says a count."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stack_counter.config import CounterConfig
from stack_counter.errors import WeightsError
from stack_counter.occupancy import make_estimator
from stack_counter.occupancy.baselines import Baselines, Prior
from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.direct_count import (
    TYPICAL_COUNT,
    DirectCount,
    fit_to_tile,
    predict_count,
)
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.maps import TILE, make_maps
from stack_counter.train import direct
from stack_counter.train.data.heights import Sample
from stack_counter.train.member import TrainingData
from stack_counter.types import Container, HeightMap, StackVolume, ViewTally

SMALL = NetConfig((8, 8, 16, 16), (1, 1, 1, 1), 16)


def maps(side, height):
    top = np.full((side, side), height, np.float32)
    return make_maps(top, np.zeros_like(top), np.ones_like(top, bool), True)


def volume(v):
    heights = np.full((40, 60), 0.05, np.float32)
    surface = HeightMap(np.eye(4), 0.002, heights)
    return StackVolume(0, v, 0.0, Container("box", np.eye(4)), (0, 0, 0), 1.0, surface,
                       replace(surface, heights=np.zeros_like(heights)), None, ViewTally())


def test_a_picture_twice_as_fine_is_the_same_picture():
    one, two = fit_to_tile(maps(48, 3.0)), fit_to_tile(maps(96, 6.0))
    assert one.top.shape == (TILE, TILE)
    assert np.allclose(one.top, two.top, atol=1e-4) and (one.valid == two.valid).all()
    assert one.valid.mean() == pytest.approx(0.64, abs=0.02)


def test_gamma_is_what_gives_the_count(tmp_path):
    torch.manual_seed(0)
    net, path = GammaNet(SMALL).eval(), tmp_path / "w.safetensors"
    save_members(path, [net], {"learnt": "count"}, {"scores": np.linspace(-1, 1, 9)})
    estimator = make_estimator(CounterConfig(estimator="direct", weights=str(path)))
    stack = volume(1e-3)
    counts = []
    for unit in (1e-6, 4e-6):
        estimate = estimator.estimate(stack, unit)
        counts.append(estimate.gamma * stack.stack_volume / unit)
    assert counts[0] == pytest.approx(counts[1], rel=0.02)  # it does not know v
    assert 0.05 * TYPICAL_COUNT < counts[0] < 20 * TYPICAL_COUNT


def test_other_weights_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_members(path, [GammaNet(SMALL)], {}, {"scores": np.zeros(3)})
    with pytest.raises(WeightsError, match="has learnt 'gamma'; expected 'count'"):
        DirectCount(path, Prior(Baselines()))


def test_training_writes_what_the_estimator_loads(tmp_path, monkeypatch):
    def sample(i):
        return Sample(maps(64, 1.0 + i % 5), 0.5, np.zeros(3, np.float32), 0.01, f"0:{i}",
                      ["nut", "tube", "ring", "ball", "cube"][i % 5], "bin", 40 * (1 + i % 5), 0.5)
    samples = [sample(i) for i in range(40)]
    data = TrainingData(samples, [i % 2 == 0 for i in range(40)], np.ones(40))
    monkeypatch.setattr(direct, "load_data", lambda _: data)
    monkeypatch.setattr(direct, "_WIDTHS", (8, 8, 8, 8))
    monkeypatch.setattr("sys.argv", ["direct", "--data", "x", "--out", str(tmp_path),
                                     "--epochs", "1"])
    assert direct.main() == 0
    loaded = DirectCount(tmp_path / "direct.safetensors", Prior(Baselines()))
    prediction = predict_count(loaded._net, fit_to_tile(samples[0].maps))
    assert np.isfinite(prediction.log_count) and prediction.std > 0
