# SPDX-License-Identifier: Apache-2.0
"""Measuring V's bias and errors: known ones are found again, and the shipped file is what a small
run finds, within its noise."""

import json
import sys
from dataclasses import asdict, fields, replace
from pathlib import Path

import numpy as np
import pytest

from stack_counter.errors import ConfigError
from stack_counter.files import shipped_weights
from stack_counter.fusion.volume_model import VolumeModel, read_volume_model, volume_model
from stack_counter.train import volume_model as command
from stack_counter.train.data.volume_errors import ARC, ONE_SIDE, PICTURES, VolumeErrors
from stack_counter.train.data.volume_fit import MeasuredNumber, measure_numbers

DATA = Path(__file__).parents[2] / "data"
NAMES = [field.name for field in fields(VolumeModel)]
KNOWN = VolumeModel(
    hidden_share=0.5, hidden_share_one_side=0.7, hidden_share_one_side_heap=0.9,
    worn_height_m=0.003, level_std_m=0.0004, level_std_per_noise=0.6, wall_std_m=0.0005,
    filled_in_std=0.2, floor_std_per_wall=0.3, volume_std=0.08, heap_std=0.12,
    lost_rim_width_m=0.002, lost_rim_width_per_noise=1.5, lost_rim_width_std=0.25,
    stereo_std=0.15)


def drawn_scan(number, views, model, random):
    """Errors of a scan whose every quantity is drawn with the errors of a model."""
    noisy, is_heap = number % 3 == 2, number % 2 == 1
    true_volume, depth_noise = 0.001, random.uniform(0.0008, 0.003)
    area = random.uniform(0.01, 0.04)
    hidden = random.uniform(0.05, 0.4) * true_volume
    floor = 0.0 if is_heap else 0.004
    share = model.hidden_share if views == ARC else \
        model.hidden_share_one_side_heap if is_heap else model.hidden_share_one_side
    scan = VolumeErrors(
        scene=f"0:{number}", views=views, noise_factor=2.0 if noisy else 1.0,
        depth_noise_m=depth_noise, is_heap=is_heap, true_volume=true_volume, volume=true_volume,
        volume_std=0.0, area=area, hidden_area=0.2 * area, hidden_fill=hidden,
        seen_fill=true_volume - share * hidden - model.worn_height_m * area,
        rim_length=0.0 if is_heap else 0.6, opening_area=0.022, assumed_floor=floor)
    std = scan.volume_std_of(model)
    filled_in = model.hidden_share * hidden + model.worn_height_m * scan.hidden_area
    lost = model.lost_rim_width_m + model.lost_rim_width_per_noise * depth_noise
    if views == PICTURES:
        std = 0.02 * true_volume
        shipped = volume_model().stereo_std * true_volume
        return replace(scan, volume_std=np.hypot(std, shipped), volume=true_volume + random.normal(
            0, np.hypot(std, model.stereo_std * true_volume)))
    return replace(
        scan, seen_fill=scan.seen_fill + random.normal(0, std),
        true_hidden_fill=filled_in * (1 + random.normal(0, model.filled_in_std)),
        crest_worn=random.normal(0.0007, model.level_std_m
                                 + model.level_std_per_noise * depth_noise),
        wall_offset=np.nan if is_heap else random.normal(0, model.wall_std_m),
        floor_error=np.nan if is_heap else floor * random.normal(0, model.floor_std_per_wall),
        lost_rim_width=np.nan if is_heap else lost * random.normal(1, model.lost_rim_width_std))


@pytest.fixture(scope="module")
def drawn():
    """Numbers measured on scans that were drawn with the errors of `KNOWN`."""
    random = np.random.default_rng(0)
    scans = [drawn_scan(i, views, KNOWN, random) for i in range(450)
             for views in (ARC, ONE_SIDE, PICTURES)]
    return measure_numbers(scans, volume_model())


@pytest.mark.parametrize("name", NAMES)
def test_a_known_number_is_found_again(drawn, name):
    known, number = getattr(KNOWN, name), drawn[name]
    assert abs(number.measured - known) < 4 * number.std_error
    assert number.std_error < 0.4 * known
    assert number.scans > 50


def test_too_few_scans_measure_nothing():
    scan = drawn_scan(0, ARC, KNOWN, np.random.default_rng(0))
    assert measure_numbers([scan, scan], volume_model()) == {}


def shipped_numbers():
    """What the shipped file says was measured beside each value."""
    entries = json.loads(shipped_weights("volume.json").read_text())["numbers"]
    return {name: MeasuredNumber(entry["measured"], entry["std_error"], entry["scans"])
            for name, entry in entries.items()}


def disagreeing(small, large):
    """Names of the numbers of a small run that lie outside its noise: what it says itself, or what
    the large run's standard error makes of so few scans, whichever is larger."""
    def noise(name):
        return max(small[name].std_error,
                   large[name].std_error * np.sqrt(1 + large[name].scans / small[name].scans))

    return [name for name in small
            if abs(small[name].measured - large[name].measured) > 4 * noise(name)]


@pytest.fixture(scope="module")
def small_run():
    """Numbers of a run on a few training scenes; heaps are too rare in it to say something.

    Seed 1 draws so few bins that only five numbers are measured.
    """
    jobs = list(command.plan_scans([DATA / "train-deep", DATA / "train-shallow"], scenes=10,
                                   pictures=0, seed=2))
    errors, _ = command.run_scans(jobs, log=None, workers=1)
    return measure_numbers(errors, volume_model())


def test_the_shipped_file_is_what_a_small_run_measures(small_run):
    assert len(small_run) >= 10
    assert disagreeing(small_run, shipped_numbers()) == []


@pytest.mark.parametrize("name", [
    "hidden_share", "hidden_share_one_side", "worn_height_m", "wall_std_m", "filled_in_std",
    "floor_std_per_wall", "lost_rim_width_m", "lost_rim_width_std"])
def test_a_wrong_number_is_noticed(small_run, name):
    large = shipped_numbers()
    wrong = replace(large[name], measured=10 * large[name].measured)
    assert name in disagreeing(small_run, {**large, name: wrong})


def test_the_shipped_file_holds_a_measurement_of_all_that_depth_views_show():
    measured = {name for name, number in shipped_numbers().items() if number.scans >= 4}
    assert measured >= set(NAMES) - {"stereo_std"}


def test_the_command_writes_what_the_run_time_reads(tmp_path, monkeypatch):
    random = np.random.default_rng(1)
    scans = [drawn_scan(i, ARC, KNOWN, random) for i in range(60)]
    monkeypatch.setattr(command, "plan_scans", lambda *_: [])
    monkeypatch.setattr(command, "run_scans", lambda *_: (scans, 3))
    for keep in ([], ["--values", str(shipped_weights("volume.json"))]):
        out = tmp_path / "volume.json"
        monkeypatch.setattr(sys, "argv", ["volume_model", "data/x", "--out", str(out), *keep])
        assert command.main() == 0
        model, content = read_volume_model(out), json.loads(out.read_text())
        measured = content["numbers"]["hidden_share"]["measured"]
        assert model.hidden_share == (volume_model().hidden_share if keep else measured)
        assert model.stereo_std == volume_model().stereo_std
        assert content["numbers"]["stereo_std"]["measured"] is None
        assert content["measurement"]["refused"] == 3


def test_a_run_goes_on_where_its_log_ends(tmp_path, monkeypatch):
    job = next(command.plan_scans([DATA / "train-deep"], 1, 0, 0))
    line = {**asdict(drawn_scan(0, ARC, KNOWN, np.random.default_rng(0))), "scene": job.key[0]}
    monkeypatch.setattr(command, "run_scan", lambda job: made.append(job) or line)
    made, log = [], tmp_path / "log.jsonl"
    for _ in range(2):
        errors, refused = command.run_scans([job], log, workers=1)
        assert (errors[0].scene, refused, len(made)) == (job.key[0], 0, 1)


@pytest.mark.parametrize("name, message", [("unseen-mixed", "test set"), ("empty", "no shard_")])
def test_test_sets_and_empty_folders_are_refused(tmp_path, name, message):
    (tmp_path / name).mkdir()
    with pytest.raises(ConfigError, match=message):
        next(command.plan_scans([tmp_path / name], 1, 0, 0))
