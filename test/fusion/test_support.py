# SPDX-License-Identifier: Apache-2.0
"""The support plane among level parts, walls and floors: points on a grid."""

import numpy as np
import pytest

from stack_counter.fusion.support import SETTINGS, find_support_plane

STEP, NOISE = 0.002, 0.0005
Y, X = np.mgrid[-0.3:0.3:STEP, -0.3:0.3:STEP]
LOW, HIGH = np.array([-0.12, -0.1, -0.02]), np.array([0.12, 0.1, 0.12])


def points_of(heights, seen=None):
    """(n, 3) noisy points of a map of heights, metres; those of `seen` alone."""
    noisy = heights + np.random.default_rng(0).normal(0, NOISE, heights.shape)
    points = np.stack([X, Y, noisy], axis=-1)
    return points[np.ones_like(heights, bool) if seen is None else seen]


def level_bin(fill=0.035, rim=0.07, half=(0.1, 0.08)):
    """A bin whose parts lie level over all of its floor."""
    out = np.maximum(np.abs(X) - half[0], np.abs(Y) - half[1])
    return np.where(out < 0, fill, np.where(out < 0.004, rim, 0.0))


WHOLE = np.maximum(np.abs(X) - 0.12, np.abs(Y) - 0.1) < 0


def test_the_plane_with_the_most_area():
    plane = find_support_plane(points_of(level_bin()))
    assert plane.height == pytest.approx(0.0, abs=2e-4)
    assert plane.noise == pytest.approx(NOISE, rel=0.2)
    assert plane.is_certain


def test_a_region_filled_with_level_parts_has_its_plane_outside():
    heights = level_bin(half=(0.115, 0.095))
    plane = find_support_plane(points_of(heights), np.nan, LOW, HIGH)
    assert plane.height == pytest.approx(0.0, abs=2e-4) and plane.is_certain


def test_a_region_on_a_table_does_not_take_the_hall_floor():
    on_table = level_bin() + np.where(np.maximum(np.abs(X), np.abs(Y)) < 0.2, 0.0, -0.8)
    plane = find_support_plane(points_of(on_table), np.nan, LOW, HIGH)
    assert plane.height == pytest.approx(0.0, abs=2e-4) and plane.is_certain


def test_a_given_height_is_used():
    plane = find_support_plane(points_of(level_bin(), WHOLE & (level_bin() > 0.01)), 0.0)
    assert (plane.height, plane.noise, plane.is_certain) == (0.0, SETTINGS.unknown_noise, True)
    plane = find_support_plane(points_of(level_bin()), 0.001)
    assert plane.height == 0.001 and plane.noise == pytest.approx(NOISE, rel=0.2)


@pytest.mark.parametrize("heights", [
    level_bin(),  # its fill is level within its walls, and nothing beside them is seen
    0.04 - 0.03 * ((np.floor(X / 0.02) + np.floor(Y / 0.02)) % 3 == 0),  # parts, gaps between
], ids=["within walls", "lower things show through"])
def test_level_parts_alone_are_no_support(heights):
    seen = np.maximum(np.abs(X) - 0.104, np.abs(Y) - 0.084) < 0
    assert not find_support_plane(points_of(heights, seen)).is_certain


def test_round_parts_that_lie_side_by_side_are_no_support():
    """Their waves look like noise to who does not see that neighbours agree."""
    waves = 0.02 * np.sin(X / 0.02) * np.sin(Y / 0.02)
    assert not find_support_plane(points_of(waves)).is_certain
