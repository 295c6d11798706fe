# SPDX-License-Identifier: Apache-2.0
"""The ablation: every variant is one of the settings, and is measured on families left out."""

import argparse
from dataclasses import replace

import numpy as np
import pytest

from stack_counter.occupancy.gamma_net import NetConfig
from stack_counter.occupancy.maps import make_maps
from stack_counter.train import ablate
from stack_counter.train.data.heights import Sample
from stack_counter.train.member import TrainConfig, TrainingData

SMALL = NetConfig((8, 8, 16, 16), (1, 1, 1, 1), 16)


def data(count):
    top = np.random.default_rng(0).uniform(1, 3, (48, 48)).astype(np.float32)
    maps = make_maps(top, np.zeros_like(top), np.ones_like(top, bool), True)
    # Each scene twice: fused, and as cast two samples on.
    samples = [Sample(maps, 0.3 + i / 99, np.zeros(3, np.float32), 0.012, f"0:{i // 4}{i % 2}",
                      ("nut", "tube")[i % 2], "bin", 40, 0.6) for i in range(count)]
    return TrainingData(samples, [i % 4 < 2 for i in range(count)], np.ones(count))


@pytest.mark.parametrize("variant", ablate.VARIANTS.values())
def test_a_variant_changes_settings_that_there_are(variant):
    replace(NetConfig(), **variant.net)
    replace(TrainConfig(), **variant.training)


def test_a_variant_is_measured_at_each_level_of_knowledge(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(ablate, "SHIPPED_NET", replace(SMALL, knows_form=True))
    monkeypatch.setattr(ablate, "load_data", lambda *_: data(16))
    monkeypatch.setattr(ablate, "assign_folds", lambda _: {"nut": 0, "tube": 1})
    options = argparse.Namespace(data=["x"], scans=[], out=tmp_path, epochs=1, seed=0, workers=1)
    rows = [ablate.run_variant(options, name, 1, 0) for name in ("knows v alone", "as shipped")]
    assert [row["scenes"] for row in rows] == [8, 8]
    assert "mae_mesh" not in rows[0] and rows[1]["mae_mesh"] > 0
    assert all(row["nae"] > 0 and row["ideal_mae"] > 0 for row in rows)
    ablate.print_table(rows, [row["variant"] for row in rows])
    first, second = capsys.readouterr().out.splitlines()[-2:]
    assert first.startswith("knows v alone") and "mesh known" in second
    assert "  ideal depth: MAE " in first and first.count("count NAE") == 2


def test_the_same_scenes_are_seen_fused_and_with_ideal_depth(tmp_path, monkeypatch):
    monkeypatch.setattr(ablate, "load_data", lambda *_: data(16))
    monkeypatch.setattr(ablate, "assign_folds", lambda _: {"nut": 0, "tube": 1})
    options = argparse.Namespace(data=["x"], scans=[], seed=0)
    learnt, fused, ideal = ablate._split(options, ablate.Variant(), TrainConfig(), 1)
    assert [s.name for s in fused.samples] == [s.name for s in ideal.samples] != []
    assert [s.gamma for s in fused.samples] != [s.gamma for s in ideal.samples]
    assert all(fused.fused) and all(ideal.fused)  # neither is degraded
    assert {s.family for s in learnt.samples} == {"nut"}
