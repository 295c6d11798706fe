# SPDX-License-Identifier: Apache-2.0
"""What stereo does to a surface: gaps close, fine structure goes."""

from dataclasses import replace

import numpy as np
import pytest

from stack_counter.occupancy.maps import make_maps
from stack_counter.train.data.heights import SETTINGS as ARC
from stack_counter.train.data.heights import Sample, count_views_of_cells
from stack_counter.train.data.stereo_surface import (
    PICTURES,
    SETTINGS,
    degrade_like_stereo,
    draw_resolution,
    stereo_surface,
)

QUIET = replace(SETTINGS, noise=0.0, share_std=0.0)
SIDE = 80
VALID = np.ones((SIDE, SIDE), bool)


def with_gap(width, depth=2.0):
    """A level surface with a gap of so many pixels across its middle."""
    top = np.full((SIDE, SIDE), 3.0, np.float32)
    top[:, (SIDE - width) // 2:(SIDE + width) // 2] -= depth
    return top


def as_stereo(top, resolution, settings=QUIET, seed=0):
    seen_by = count_views_of_cells(top, VALID, 3.0, np.random.default_rng(0))
    return stereo_surface(top, (seen_by / ARC.views).astype(np.float32), VALID, resolution,
                          np.random.default_rng(seed), settings)


def test_a_level_surface_stays_but_for_noise():
    level = np.full((SIDE, SIDE), 3.0, np.float32)
    np.testing.assert_allclose(as_stereo(level, 0.2), level, atol=1e-5)
    noise = as_stereo(level, 0.2, SETTINGS) - level
    assert noise.std() == pytest.approx(SETTINGS.noise * 0.2, rel=0.2)
    np.testing.assert_array_equal(noise, as_stereo(level, 0.2, SETTINGS) - level)


def test_a_narrow_gap_closes_and_a_wide_one_does_not():
    middle = SIDE // 2
    assert as_stereo(with_gap(2), 0.15)[middle, middle] > 2.8
    assert as_stereo(with_gap(48), 0.15)[middle, middle] < 1.1


def test_fine_structure_goes_and_an_edge_stays():
    random = np.random.default_rng(0)
    rough = (3 + 0.1 * random.standard_normal((SIDE, SIDE))).astype(np.float32)
    assert as_stereo(rough, 0.15)[8:-8, 8:-8].std() < 0.6 * 0.1
    wall = np.full((SIDE, SIDE), 3.0, np.float32)
    wall[:, :SIDE // 2] += 1
    assert np.mean(as_stereo(wall, 0.15) > 3.5) == pytest.approx(0.5, abs=1.01 / SIDE)


def test_a_sample_is_degraded_where_it_is_valid():
    top, valid = with_gap(4), VALID.copy()
    valid[:10] = False
    maps = make_maps(np.where(valid, top, 0), np.zeros_like(top), valid, True)
    sample = Sample(maps, 0.5, np.zeros(3, np.float32), 0.012, "0:0", "nut", "bin", 40, 0.6,
                    seen_by=np.where(valid, ARC.views, 0).astype(np.uint8))
    out = degrade_like_stereo(sample, 0.2, np.random.default_rng(0))
    assert not out.top[:10].any() and not out.height[:10].any()
    assert out.height[10:].min() >= 0 and np.isfinite(out.top).all()
    assert out.valid is valid and out.wall is maps.wall


def test_a_resolution_is_a_voxel_at_least():
    random = np.random.default_rng(0)
    small, large = ([draw_resolution(length, random) for _ in range(99)]
                    for length in (0.008, 0.1))
    assert min(small) == pytest.approx(0.25) and max(small) <= PICTURES.resolution[1]
    assert PICTURES.resolution[0] <= min(large) < 0.1 and max(large) > 0.25
