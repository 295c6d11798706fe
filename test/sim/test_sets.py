# SPDX-License-Identifier: Apache-2.0
"""The committed sets of scenes: whole, of the right families, with the truth of their poses."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from stack_counter.sim import read_scenes
from stack_counter.sim.shapes import FAMILIES
from stack_counter.sim.shapes.extra import sparse, unseen

DATA = Path(__file__).parents[2] / "data"


@pytest.mark.parametrize("name", ["unseen", "unseen-mixed"])
def test_a_test_set_is_a_hundred_scenes_of_unseen_families(name):
    scenes = list(read_scenes(DATA / name))
    assert [s.index for s in scenes] == list(range(100))
    assert not {s.shape.family for s in scenes} & set(FAMILIES)
    assert len({(s.shape.family, s.shape.seed) for s in scenes}) > 60
    gamma = np.array([s.truth.gamma for s in scenes])
    assert np.all((gamma > 0) & (gamma <= 1))
    again = replace(scenes[50], stored_truth=None)
    assert again.truth.stack_volume == pytest.approx(scenes[50].truth.stack_volume, rel=1e-6)


def test_unseen_is_comparable_with_the_papers_test_set():
    scenes = list(read_scenes(DATA / "unseen"))
    assert {s.container.kind for s in scenes} == {"bin"}
    width = [s.container.inner_size_m[0] / s.shape.part_size for s in scenes]
    assert 4 <= min(width) and max(width) <= 6.5
    counts = [len(s.poses) for s in scenes]
    assert 12 <= min(counts) and max(counts) <= 700


@pytest.mark.parametrize("name", ["train-shallow", "train-deep"])
def test_training_scenes_are_of_the_training_families(name):
    scenes = list(read_scenes(DATA / name, 60))  # into the second shard
    assert len(scenes) == 60 and {s.shape.family for s in scenes} <= set(FAMILIES)
    again = replace(scenes[7], stored_truth=None)
    assert again.truth.stack_volume == pytest.approx(scenes[7].truth.stack_volume, rel=1e-6)


def test_the_sparse_set_reaches_below_a_twentieth_and_holds_families_of_its_own():
    scenes = list(read_scenes(DATA / "train-sparse"))
    families = {s.shape.family for s in scenes}
    assert families == set(sparse.GENERATORS)
    assert not families & (set(FAMILIES) | set(unseen.GENERATORS))
    gamma = np.array([s.truth.gamma for s in scenes])
    assert gamma.min() < 0.03 and np.mean(gamma < 0.05) > 0.4 and gamma.max() < 0.2
    again = replace(scenes[30], stored_truth=None)
    assert again.truth.stack_volume == pytest.approx(scenes[30].truth.stack_volume, rel=1e-6)
