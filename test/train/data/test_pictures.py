# SPDX-License-Identifier: Apache-2.0
"""Rendered key views as samples and batches."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from kits.disc_pictures import made_up

from stack_counter.errors import ConfigError
from stack_counter.picture_baselines.bmnet import BMNetConfig
from stack_counter.sim import picture_key_view, read_shard
from stack_counter.tasks.workers import Workers
from stack_counter.train.data import pictures
from stack_counter.train.data.picture_batches import (
    density_map,
    draw_rows,
    make_density_batch,
    make_log_batch,
)
from stack_counter.train.data.pictures import SIDE_PX, load_picture_samples

DATA = Path(__file__).parents[3] / "data" / "train-deep"


def test_scenes_are_rendered_once_and_kept(tmp_path, monkeypatch):
    scenes = list(read_shard(DATA / "shard_00000.npz"))[:2]
    shutil.copy(DATA / "shard_00000.npz", tmp_path)
    monkeypatch.setattr(pictures, "read_shard", lambda path: scenes)
    samples = load_picture_samples([tmp_path], tmp_path / "cache", Workers())
    monkeypatch.setattr(pictures, "read_shard", lambda path: pytest.fail("rendered again"))
    again = load_picture_samples([tmp_path], tmp_path / "cache", Workers())
    assert [s.count for s in samples] == [s.truth.count for s in scenes]
    assert [s.name for s in again] == [f"{s.seed}:{s.index}" for s in scenes]
    key = picture_key_view(scenes[1], seed=scenes[1].index)
    for sample in (samples[1], again[1]):
        assert sample.color.shape == (SIDE_PX, SIDE_PX, 3)
        assert len(sample.centers) == len(sample.boxes) == key.visible_count
        assert sample.gamma == scenes[1].truth.gamma
        # A part's middle lies in its box, and the box in the square.
        assert (sample.boxes[:, :2] <= sample.centers).all()
        assert (sample.centers <= sample.boxes[:, 2:]).all()
        assert sample.boxes.min() >= -1 and sample.boxes.max() <= SIDE_PX


def test_a_folder_without_scenes_is_refused(tmp_path):
    with pytest.raises(ConfigError, match="expected shard_"):
        load_picture_samples([tmp_path], tmp_path, Workers())


def test_a_density_sums_up_to_the_parts_wherever_they_are():
    centers = np.array([[0, 0], [100, 30], [255, 255]], np.float32)
    density = density_map(centers)
    assert density.sum() == pytest.approx(3, abs=1e-4)
    assert density_map(centers[1:2]).argmax() == (30 // 8) * (SIDE_PX // 8) + 100 // 8
    assert density_map(np.zeros((0, 2))).sum() == 0


def test_turned_pictures_keep_their_densities_on_the_parts():
    samples = [made_up(k) for k in (2, 3, 4, 5)]
    x, patches, scales, density = make_density_batch(
        samples, np.random.default_rng(1), BMNetConfig())
    assert patches.shape == (4, 3, 3, 64, 64) and scales.shape == (4, 3)
    assert density.sum((1, 2)).numpy() == pytest.approx([2, 3, 4, 5], rel=1e-4)
    for picture, of in zip(x, density):
        # Where density is highest there is a disc.
        row, col = divmod(int(of.argmax()), SIDE_PX // 8)
        assert picture[:, row * 8 + 4, col * 8 + 4].min() > picture.mean()


def test_logs_of_count_and_gamma():
    samples = [made_up(k) for k in (5, 50)]
    x, logs = make_log_batch(samples, None, "count", 128)
    assert x.shape == (2, 3, 128, 128)
    assert logs.numpy() == pytest.approx(np.log([5, 50]))
    assert make_log_batch(samples, None, "gamma", 128)[1].numpy() == pytest.approx(
        np.log([0.305, 0.35]), rel=1e-5)
    turned = make_log_batch(samples, np.random.default_rng(0), "count", 128)[0]
    assert not np.array_equal(turned.numpy(), x.numpy())


def test_all_samples_are_drawn_alike():
    rows = draw_rows(10, 4, 5, (0, 1))
    assert rows.shape == (5, 4) and np.bincount(rows.ravel()).tolist() == [2] * 10
    assert np.array_equal(rows, draw_rows(10, 4, 5, (0, 1)))
