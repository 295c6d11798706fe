# SPDX-License-Identifier: Apache-2.0
"""The training loop: learns, resumes where it was killed, leaves families out; calibration."""

import argparse
import json
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch

from stack_counter.errors import ConfigError
from stack_counter.occupancy import checkpoint
from stack_counter.occupancy.baselines import Baselines, Prior
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.maps import make_maps
from stack_counter.occupancy.network import GammaPrediction, NetworkEstimator
from stack_counter.train import calibrate, gamma, member
from stack_counter.train import residuals as counted
from stack_counter.train.data.batches import assign_folds
from stack_counter.train.data.fused import FusedScan
from stack_counter.train.data.heights import Sample, write_samples
from stack_counter.types import KnownLevel

SMALL = NetConfig((8, 8, 16, 16), (1, 1, 1, 1), 16)


@pytest.fixture(autouse=True)
def small_networks(monkeypatch):
    monkeypatch.setattr(member, "make_net", lambda *_: GammaNet(SMALL))


def sample(i, family="nut"):
    """The finer the bumps, the smaller gamma."""
    y, x = np.mgrid[:64, :64] / 8
    fine = 0.6 + i % 8 / 2
    top = (3 + 0.4 * np.sin(fine * x + i) * np.cos(fine * y)).astype(np.float32)
    maps = make_maps(top, np.zeros_like(top), np.ones_like(top, bool), True)
    return Sample(maps, 0.8 / fine, np.zeros(3, np.float32), 0.012, f"0:{i}", family, "bin", 40,
                  0.6)


def data(count, family="nut"):
    samples = [sample(i, family) for i in range(count)]
    return member.TrainingData(samples, [i % 2 == 0 for i in range(count)], np.ones(count))


def history(path):
    return torch.load(path, weights_only=True)["history"]


def test_it_learns_and_keeps_its_best(tmp_path):
    torch.manual_seed(0)
    config, path = member.TrainConfig(epochs=4, batch=8, rate=1e-2), tmp_path / "member_0.pt"
    member.train_member(GammaNet(SMALL), data(64), data(8), config, path)
    lines = history(path)
    assert len(lines) == 4 and lines[-1]["loss"] < lines[0]["loss"]
    assert member.read_member(path)[1] == lines
    gamma.plot_curves(tmp_path)
    assert (tmp_path / "curves.png").read_bytes()[:4] == b"\x89PNG"


def test_a_network_that_knows_the_form_is_measured_at_each_level(tmp_path):
    config, path = member.TrainConfig(epochs=1, batch=8), tmp_path / "member_0.pt"
    net = GammaNet(replace(SMALL, knows_form=True))
    member.train_member(net, data(32), data(8), config, path)  # four steps leave one to warm up
    line = history(path)[0]
    assert {"mae", "mae_size", "mae_mesh"} <= set(line)
    assert member.read_member(path)[0].config == net.config


def test_a_network_that_knows_the_resolution_is_measured_on_pictures_too(tmp_path):
    config, path = member.TrainConfig(epochs=1, batch=8, pictures=0.5), tmp_path / "member_0.pt"
    seen = data(16)
    seen = replace(seen, samples=[replace(s, seen_by=np.full((64, 64), 12, np.uint8))
                                  for s in seen.samples])
    net = GammaNet(replace(SMALL, knows_resolution=True))
    member.train_member(net, seen, seen, config, path)
    assert history(path)[0]["mae_pictures"] > 0
    assert member.read_member(path)[0].config == net.config


def test_after_a_kill_it_goes_on_where_it_was(tmp_path, monkeypatch):
    config, path = member.TrainConfig(epochs=3, batch=8), tmp_path / "member_0.pt"
    evaluate, calls = member.measure_held_out, []

    def killed(*args):
        calls.append(1)
        if len(calls) == 2:
            raise KeyboardInterrupt
        return evaluate(*args)
    monkeypatch.setattr(member, "measure_held_out", killed)
    with pytest.raises(KeyboardInterrupt):
        member.train_member(GammaNet(SMALL), data(16), data(8), config, path)
    first = history(path)
    member.train_member(GammaNet(SMALL), data(16), data(8), config, path)
    assert len(first) == 1 and len(history(path)) == 3 and history(path)[0] == first[0]


def test_it_stops_when_nothing_improves(tmp_path, monkeypatch):
    monkeypatch.setattr(member, "measure_held_out", lambda *_: {"score": 1.0, "mae": 1.0})
    config, path = member.TrainConfig(epochs=9, batch=8, patience=2), tmp_path / "member_0.pt"
    member.train_member(GammaNet(SMALL), data(8), data(8), config, path)
    assert len(history(path)) == 3


def test_a_folder_without_scenes_is_refused(tmp_path):
    def options(text):
        return argparse.Namespace(data=[text], scans=[], cache=tmp_path / "c", workers=1)
    with pytest.raises(ConfigError, match="expected shard_"):
        gamma.load_data(options(tmp_path))
    with pytest.raises(ConfigError, match="weight 'x'"):
        gamma.load_data(options(f"{tmp_path}:x"))


@pytest.fixture
def two_sources(tmp_path, monkeypatch):
    """Options of a training on four families, one of them KiCad's."""
    families = ["KiCad/Chip", "LDraw/Brick", "nut", "tube"]
    parts = [data(16, family) for family in families]
    monkeypatch.setattr(gamma, "load_data", lambda _: member.TrainingData(
        [s for part in parts for s in part.samples], [False] * 64, np.ones(64)))
    monkeypatch.setattr(gamma, "make_net", lambda *_: GammaNet(SMALL))
    return argparse.Namespace(out=tmp_path, folds=[0], scenes=None, epochs=1, seed=0, workers=1,
                              encoder="own", encoder_weights=None, leave_out_source=["KiCad"],
                              start=None, rate=2e-3)


def test_a_source_left_out_is_seen_by_no_member_and_tests_each(two_sources, monkeypatch, capsys):
    seen, train = [], gamma.train_member

    def watched(net, learnt, held_out, *more, **options):
        seen.extend(learnt.families + held_out.families)
        train(net, learnt, held_out, *more, **options)
    monkeypatch.setattr(gamma, "train_member", watched)
    families = ["KiCad/Chip", "LDraw/Brick", "nut", "tube"]
    gamma.train_fold(two_sources, assign_folds(families)["nut"])
    assert sorted(seen) == ["LDraw/Brick", "nut", "tube"]
    name, of_kicad = capsys.readouterr().out.splitlines()[-1].split(" on KiCad ")
    assert name.startswith("member_") and json.loads(of_kicad)["mae"] > 0


def test_a_source_that_is_not_there_cannot_be_left_out(two_sources):
    two_sources.leave_out_source = ["kicad"]
    with pytest.raises(ConfigError, match="source kicad: .*; expected some of: KiCad, LDraw$"):
        gamma.run(two_sources)


def test_the_shipped_file_is_made_of_errors_on_families_left_out(tmp_path, monkeypatch):
    """Members guess the truth with a bias that depends on who guesses."""
    torch.manual_seed(0)
    scans = [FusedScan(sample(i, family), 1e-3, 1.1e-3, 2e-5, True)
             for i in range(12) for family in ("nut", "tube")]
    fold = {"nut": 0, "tube": 1}
    seen = []

    def predict(ensemble, maps, known, resolution):
        seen.extend(ensemble._members)
        return GammaPrediction(0.0, 0.2, np.zeros(3))
    monkeypatch.setattr(counted, "predict_gamma", predict)
    nets = {0: GammaNet(SMALL), 1: GammaNet(SMALL)}
    of = counted.count_with_members(nets, scans, fold, calibrate.fit_training_domain(scans))
    assert len(of) == 24
    assert all(net is nets[fold[r.scan.sample.family]] for net, r in zip(seen, of))
    assert of[0].log_count_ratio == pytest.approx(np.log(of[0].scan.sample.gamma) - np.log(1.1))
    assert of[0].relative_std == pytest.approx(np.hypot(0.2, 2 / 110))
    unknown = calibrate.TrainingDomain(np.full(6, 99.0), np.eye(6), np.ones(1))
    doubted = counted.count_with_members(nets, scans, fold, unknown)
    # As the run time widens it.
    assert all(a.relative_std > 9 * b.relative_std for a, b in zip(doubted, of))


def test_the_correction_is_that_of_the_middle_source():
    """A collection that most scans are of, and that is off by far, does not set it."""
    def residuals(family, count, error):
        scan = FusedScan(replace(sample(0, family), gamma=0.5), 1e-3, 1e-3, 1e-9, True)
        return [counted.Residual(scan, 0.5 * np.exp(-error), error, 0.1)] * count
    own, bricks, odd = (residuals("nut", 20, 0.01), residuals("Bricks/plate", 90, 0.2),
                        residuals("Cups/mug", 12, -0.05))
    assert counted.median_log_error(own + bricks + odd) == pytest.approx(0.01)
    assert counted.median_log_error(own + bricks + residuals("Few/one", 3, -9.0)) \
        == pytest.approx((0.01 + 0.2) / 2)
    assert counted.median_log_error(residuals("Few/one", 3, 0.3)) == pytest.approx(0.3)


def test_members_together_are_as_much_surer_as_their_errors_cancel(monkeypatch):
    """Both are off by 0.1 of the same sign for all, and by 0.2 more with a sign of their own."""
    torch.manual_seed(0)
    scans = [FusedScan(replace(sample(i), gamma=0.5), 1e-3, 1e-3, 1e-9, True) for i in range(40)]
    nets = [GammaNet(SMALL), GammaNet(SMALL)]
    order = {id(scan.sample.maps): i for i, scan in enumerate(scans)}

    def predict(ensemble, maps, known, resolution):
        i = order[id(maps)]
        own = [0.2 * (-1) ** (i // (1 + nets.index(net))) for net in ensemble._members]
        return GammaPrediction(np.log(0.5) + 0.1 * (-1) ** (i // 4) + np.mean(own), 0.2,
                               np.zeros(3))
    monkeypatch.setattr(counted, "predict_gamma", predict)
    domain = calibrate.fit_training_domain(scans)
    narrowing = counted.ensemble_narrowing(nets, scans, domain, KnownLevel.VOLUME)
    # The squares are 0.09 and 0.01 of one, 0.09, 0.01 and twice 0.01 of both; gamma widens some.
    assert narrowing == pytest.approx((0.03 / 0.05) ** 0.5, abs=0.02)
    assert counted.ensemble_narrowing(nets[:1], scans, domain, KnownLevel.VOLUME) == 1
    with pytest.raises(ConfigError, match="none of 0 scans"):
        counted.ensemble_narrowing(nets, [], domain, KnownLevel.VOLUME)


@pytest.mark.parametrize("knows_form", [False, True])
def test_calibrate_writes_what_the_network_loads(tmp_path, monkeypatch, capsys, knows_form):
    monkeypatch.setattr(checkpoint, "NetConfig", lambda *a: NetConfig(*a) if a else SMALL)
    exported = []  # test_inference.py exports in truth, which takes seconds
    monkeypatch.setattr(calibrate, "export_ensemble", exported.extend)
    run, scans = tmp_path / "run", tmp_path / "scans"
    run.mkdir()
    scans.mkdir()
    families = ["nut", "tube"]
    (run / "families.json").write_text(json.dumps(families))
    config = member.TrainConfig(epochs=1, batch=8)
    for k in range(5):
        net = GammaNet(replace(SMALL, knows_form=knows_form))
        member.train_member(net, data(16), data(8), config, run / f"member_{k}.pt")
    samples = [sample(i, families[i % 2]) for i in range(20)]
    write_samples(scans / "a.npz", samples, more=np.tile([1e-3, 1e-3, 1e-5, 1], (20, 1)))
    out, pictures = tmp_path / "gamma.safetensors", tmp_path / "pictures"
    unseen = tmp_path / "unseen"
    unseen.mkdir()
    write_samples(unseen / "a.npz", [replace(s, family="wing") for s in samples[:6]],
                  more=np.tile([1e-3, 1e-3, 1e-5, 1], (6, 1)))
    pictures.mkdir()
    write_samples(pictures / "a.npz", [replace(s, resolution_m=0.003, from_pictures=True) for s in
                                       samples[:8]],
                  more=np.tile([1e-3, 1e-3, 1e-5, 1], (8, 1)))
    monkeypatch.setattr("sys.argv", ["calibrate", str(run), "--scans", str(scans), "--one-view",
                                     str(scans), "--pictures", str(pictures), "--out",
                                     str(out), "--version", "t1",
                                     *(["--unseen-scans", str(unseen)] if knows_form else [])])
    assert calibrate.main() == 0
    assert "gamma_mae" in capsys.readouterr().out
    network = NetworkEstimator(out, Prior(Baselines()))
    assert network.name == "network t1" and len(exported) == 5
    levels = 3 if knows_form else 1
    assert [scores.shape for scores in network._scores] == [
        (levels, 20), (levels, 20), (levels, 8)]
    assert network._centers.shape == (levels, 3)
    assert network._domain.distance(samples[0].maps) < 1.5
    # Parts that members have learnt from say nothing of how sure they are together.
    monkeypatch.setattr("sys.argv", [*sys.argv, "--unseen-scans", str(scans)])
    with pytest.raises(ConfigError, match="shows nut, and 1 others that members have learnt from"):
        calibrate.main()


def test_large_groups_of_families_weigh_less():
    weights = gamma.family_weights(["nut_small"] * 15 + ["nut"] + ["tube"], 0.75)
    assert weights.mean() == pytest.approx(1) and weights[0] == weights[15]
    assert weights[16] / weights[0] == pytest.approx(8)  # 16 to the power of 0.75


def test_a_checkpoint_of_another_architecture_is_refused(tmp_path):
    config, path = member.TrainConfig(epochs=1, batch=8), tmp_path / "member_0.pt"
    member.train_member(GammaNet(SMALL), data(16), data(8), config, path)
    with pytest.raises(ConfigError, match="name another --out"):
        member.train_member(GammaNet(replace(SMALL, knows_form=True)), data(16), data(8),
                            replace(config, epochs=3), path)
