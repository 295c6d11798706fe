# SPDX-License-Identifier: Apache-2.0
"""The octaves of height maps whose waves are known."""

import numpy as np
import pytest

from stack_counter.eval.common.band_power import EDGES, band_powers

PITCH, LENGTH = 0.001, 0.012


def waves(length, size=240):
    """Waves along x of so many part lengths, 1 mm high."""
    x = np.arange(size) * PITCH
    return np.tile(0.001 * np.sin(2 * np.pi * x / (length * LENGTH)), (size, 1))


@pytest.mark.parametrize("octave", range(len(EDGES) - 1))
def test_a_wave_is_in_its_own_octave(octave):
    heights = waves(np.sqrt(EDGES[octave] * EDGES[octave + 1]))
    powers = [band.true for band in band_powers(heights, heights, PITCH, LENGTH)]
    assert np.argmax(powers) == octave


def test_the_truth_is_all_kept_and_half_of_it_half():
    heights = waves(1.4) + waves(0.7)
    for factor in (1.0, 0.5):
        for band in band_powers(factor * heights + 0.3, heights, PITCH, LENGTH):
            assert band.kept == pytest.approx(factor, abs=0.01)
            assert band.measured / band.true == pytest.approx(factor**2, abs=0.01)


def test_noise_adds_power_and_keeps_nothing_more():
    random = np.random.default_rng(0)
    heights = waves(0.7)
    noisy = heights + random.normal(0, 0.001, heights.shape)
    band = band_powers(noisy, heights, PITCH, LENGTH)[-1]
    assert band.kept == pytest.approx(1, abs=0.05)
    assert band.measured > 1.5 * band.true


def test_what_is_unknown_in_either_is_left_out():
    heights = waves(1.4)
    holed, high = heights.copy(), heights.copy()
    holed[:, :60] = np.nan
    high[:, :60] += 1
    for band in band_powers(high, holed, PITCH, LENGTH):
        assert band.kept == pytest.approx(1, abs=1e-3)
