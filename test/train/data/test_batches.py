# SPDX-License-Identifier: Apache-2.0
"""Folds of families, degraded maps and turned tiles."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.occupancy.known_form import KNOWN_VALUES
from stack_counter.occupancy.maps import TILE, make_maps, network_channels
from stack_counter.train.data.batches import (
    FOLDS,
    assign_folds,
    draw_batches,
    draw_known,
    draw_tile,
    family_group,
    hide_container,
    make_input,
)
from stack_counter.train.data.degrade import degrade_like_fusion
from stack_counter.train.data.heights import Sample, read_samples, write_samples


def sample(rows=60, cols=90, gamma=0.5, family="nut", walled=True):
    y, x = np.mgrid[:rows, :cols] / 8
    top = (3 + 0.5 * np.sin(2 * x) * np.cos(2 * y)).astype(np.float32)
    maps = make_maps(top, np.full_like(top, 0.5), np.ones_like(top, bool), walled)
    return Sample(maps, gamma, np.array([0.7, -0.5, 1.9], np.float32), 0.012, "1:2", family,
                  "bin" if walled else "none", 40, 0.6)


def test_no_group_of_families_is_split_and_all_folds_are_used():
    families = [f"{begin}_{end}" for begin in "abcdefghijkl" for end in ("x", "y")]
    folds = assign_folds(families)
    assert set(folds.values()) == set(range(FOLDS))
    for family in families:
        assert folds[family] == folds[f"{family_group(family)}_x"]
    assert folds == assign_folds(families[::-1])


def test_a_further_source_moves_no_family_and_is_dealt_to_all_folds():
    ours = [f"family{i}" for i in range(12)]
    kicad = [f"KiCad/family{i}" for i in range(12)]
    folds = assign_folds(ours + kicad)
    assert {f: folds[f] for f in ours} == assign_folds(ours)
    assert {folds[f] for f in kicad} == set(range(FOLDS))


def test_sources_of_one_group_each_are_not_of_one_fold():
    folds = assign_folds([f"source{i}/all" for i in range(12)])
    assert len(set(folds.values())) >= 3


def test_families_of_two_sources_are_not_of_one_group():
    assert family_group("plate_of_bars") == "plate"
    assert family_group("KiCad/Inductor_THT") == family_group("KiCad/Inductor_SMD")
    assert len({family_group(f) for f in ("plate", "LDraw/plate", "my_bones/plate")}) == 3


@pytest.mark.parametrize("rows, cols", [(30, 40), (112, 112), (300, 90)])
def test_a_tile_keeps_the_heights_it_shows(rows, cols):
    of = sample(rows, cols).maps
    for seed in range(6):
        tile = draw_tile(of, np.random.default_rng(seed))
        assert tile.top.shape == (TILE, TILE)
        assert tile.valid.sum() > 0.5 * min(rows, 100) * min(cols, 100)
        assert 2.4 < tile.top[tile.valid].min() and tile.top.max() < 3.6
        assert tile.height[tile.valid].mean() == pytest.approx(2.5, abs=0.2)
        assert not tile.top[~tile.valid].any()


def test_degradation_smooths_and_keeps_the_mean():
    of = sample()
    out = degrade_like_fusion(of, np.random.default_rng(0))
    assert out.height.mean() == pytest.approx(of.maps.height.mean(), abs=0.1)
    bend = [np.abs(np.diff(m.top, 2)).mean() for m in (of.maps, out)]
    assert bend[1] != bend[0] and np.array_equal(out.valid, of.maps.valid)
    assert out.wall is of.maps.wall


def test_a_blinded_tile_shows_neither_wall_nor_floor():
    of = sample().maps
    deep = make_maps(of.top + 5, of.top - of.height, of.valid, True)
    x, y = hide_container(network_channels(of)), hide_container(network_channels(deep))
    np.testing.assert_allclose(x, y, atol=1e-5)
    assert (x[2] == x[1]).all()


def test_batches_depend_on_the_seed_alone():
    samples = [sample(gamma=g) for g in (0.3, 0.6)]
    weights = np.array([1.0, 3.0])
    one, two, other, by_processes = (
        [(batch.x.numpy(), batch.y.numpy()) for batch in
         draw_batches(samples, [False, True], weights, 4, 3, seed, processes=processes)]
        for seed, processes in (((0, 1), 0), ((0, 1), 0), ((0, 2), 0), ((0, 1), 2)))
    assert len(one) == 3 and one[0][0].shape == (4, 4, TILE, TILE)
    np.testing.assert_array_equal(one[2][0], two[2][0])
    for a, b in zip(one, by_processes, strict=True):
        np.testing.assert_array_equal(a[0], b[0])
    assert not np.array_equal(one[0][0], other[0][0])
    logs = np.concatenate([y[:, 0] for _, y in one])
    assert set(np.round(np.exp(logs), 3)) <= {np.float32(0.3), np.float32(0.6)}


def test_pictures_are_drawn_in_all_resolutions_beside_depth():
    of = replace(sample(), seen_by=np.full((60, 90), 12, np.uint8))
    fused = make_input(of, True, (0,), picture_share=1.0)
    assert fused.resolution[1] == 0  # what was truly fused stays as it is
    drawn = [make_input(of, False, (0, i), picture_share=0.5).resolution for i in range(40)]
    logs, from_pictures = np.array(drawn).T
    assert 0.25 < from_pictures.mean() < 0.75
    assert np.ptp(logs[from_pictures == 0]) == 0 and np.ptp(logs[from_pictures == 1]) > 0.3
    # Without pictures nothing changes.
    one, two = (make_input(s, False, (0, 1)) for s in (of, sample()))
    np.testing.assert_array_equal(one.x, two.x)


def test_what_is_known_is_hidden_at_random():
    of = replace(sample(), known=np.linspace(1, 2, KNOWN_VALUES).astype(np.float32))
    drawn = np.array([draw_known(of, (0, i)) for i in range(300)])
    size_known, mesh_known = (drawn[:, -2:] != 0).T
    assert 0.45 < size_known.mean() < 0.75 and 0.2 < mesh_known.mean() < 0.4
    assert size_known[mesh_known].all()
    assert not drawn[~size_known].any() and not drawn[~mesh_known, 3:-2].any()
    np.testing.assert_array_equal(drawn[mesh_known, 3:-2], np.tile(of.known[3:-2],
                                                                   (mesh_known.sum(), 1)))
    np.testing.assert_allclose(drawn[size_known, :3], np.tile(of.known[:3], (size_known.sum(), 1)),
                               atol=0.1)


def test_samples_come_back_from_their_file(tmp_path):
    known = np.arange(KNOWN_VALUES, dtype=np.float32)
    samples = [replace(sample(), known=known, seen_by=np.full((60, 90), 7, np.uint8)),
               sample(20, 30, 0.3, "tube", walled=False)]
    write_samples(tmp_path / "s.npz", samples, more=np.arange(2))
    for a, b in zip(samples, read_samples(tmp_path / "s.npz")):
        np.testing.assert_allclose(a.maps.top, b.maps.top, atol=0.002)
        np.testing.assert_allclose(a.maps.height, b.maps.height, atol=0.004)
        np.testing.assert_allclose(a.maps.wall, b.maps.wall, atol=1e-6)
        assert (a.gamma, a.name, a.family, a.container_kind, a.count) == (
            b.gamma, b.name, b.family, b.container_kind, b.count)
        np.testing.assert_array_equal(a.known, b.known)
        np.testing.assert_array_equal(a.seen_by, b.seen_by)
