# SPDX-License-Identifier: Apache-2.0
"""The integral of fill heights, its standard deviation, and unseen cells, in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import ndimage

from stack_counter.errors import ScanError
from stack_counter.fusion.volume_model import VolumeModel, volume_model
from stack_counter.reconstruction.integral import (
    StackBoundary,
    fill_unknown_cells,
    integrate_fill,
    volume_std,
)

CELL = 0.002**2
NO_ERROR = replace(volume_model(), **dict.fromkeys(
    ("level_std_m", "level_std_per_noise", "wall_std_m", "filled_in_std", "floor_std_per_wall",
     "volume_std", "heap_std"), 0.0))
BIN = StackBoundary(is_heap=False, rim_length=1.0, opening_area=0.06, assumed_floor=0.005)
HEAP = StackBoundary(is_heap=True, rim_length=0.0, opening_area=0.06, assumed_floor=0.0)
ALL_SEEN = np.ones(100, bool)


def level_fill(height=0.05, seen=ALL_SEEN, hidden_share=1.0, worn=0.0):
    """Integral over 100 cells filled level."""
    return integrate_fill(np.full(100, height), seen, CELL, hidden_share, worn)


def test_a_level_fill_is_height_times_area():
    integral = level_fill()
    assert integral.volume == pytest.approx(0.05 * 100 * CELL)
    assert integral.area == pytest.approx(100 * CELL)
    assert integral.filled_in == 0


def test_worn_height_is_added_where_something_is_held_and_nowhere_else():
    fill = np.array([0.05, 0.0, 0.001, -0.004])  # 1 mm is noise
    integral = integrate_fill(fill, ALL_SEEN[:4], CELL, 1.0, 0.0005)
    np.testing.assert_allclose(integral.fill, [0.0505, 0, 0, 0])
    assert integral.volume == pytest.approx(0.0505 * CELL)
    assert integral.area == pytest.approx(CELL)


def test_an_unseen_cell_counts_its_hidden_share():
    seen = ALL_SEEN.copy()
    seen[7] = False
    integral = level_fill(seen=seen, hidden_share=0.6)
    assert integral.volume == pytest.approx((99 + 0.6) * 0.05 * CELL)
    assert integral.filled_in == pytest.approx(0.6 * 0.05 * CELL)


def test_the_parts_of_a_volume_add_up_to_it():
    """Of 100 cells one is unseen and ten lie beside a wall, the unseen one among them."""
    seen, beside_wall = ALL_SEEN.copy(), ~ALL_SEEN
    seen[7], beside_wall[:10] = False, True
    integral = integrate_fill(np.full(100, 0.05), seen, CELL, 0.6, 0.0, beside_wall)
    cell = 0.05 * CELL
    assert integral.parts == pytest.approx(
        {"seen": 90 * cell, "filled": 0.6 * cell, "wall": 9 * cell})
    assert sum(integral.parts.values()) == pytest.approx(integral.volume)
    assert level_fill().parts["wall"] == 0


def test_a_sine_fill_agrees_with_its_integral():
    """0.05 + 0.02 sin(x) sin(y) over whole periods has the mean 0.05."""
    angle = 2 * np.pi * (np.arange(80) + 0.5) / 80
    fill = 0.05 + 0.02 * np.sin(angle)[:, None] * np.sin(angle)
    integral = integrate_fill(fill.ravel(), np.ones(6400, bool), CELL, 1.0, 0.0)
    assert integral.volume == pytest.approx(0.05 * 6400 * CELL)


@pytest.mark.parametrize("changed, boundary, expected", [
    ({"level_std_m": 0.001}, BIN, lambda i: 0.001 * i.area),
    ({"level_std_per_noise": 0.5}, BIN, lambda i: 0.5 * 0.002 * i.area),
    ({"volume_std": 0.03}, BIN, lambda i: 0.03 * i.volume),
    ({"filled_in_std": 0.2}, BIN, lambda i: 0.2 * i.filled_in),
    ({"wall_std_m": 0.0005}, BIN, lambda i: 0.0005 * 1.0 * i.volume / 0.06),
    ({"floor_std_per_wall": 0.1}, BIN, lambda i: 0.1 * 0.005 * i.area),
    ({"heap_std": 0.04}, BIN, lambda i: 0.0),
    ({"heap_std": 0.04}, HEAP, lambda i: 0.04 * i.volume),
    ({"floor_std_per_wall": 0.1, "wall_std_m": 0.1}, HEAP, lambda i: 0.0),
    ({"volume_std": 0.03, "heap_std": 0.04}, HEAP, lambda i: 0.05 * i.volume),
])
def test_each_error_alone_gives_its_closed_form(changed, boundary, expected):
    integral = level_fill(seen=np.arange(100) < 80, hidden_share=0.5)
    std = volume_std(integral, boundary, 0.002, replace(NO_ERROR, **changed))
    assert std == pytest.approx(expected(integral))


def test_nothing_held_has_no_error():
    model = VolumeModel(*[1.0] * 15)
    assert volume_std(level_fill(0.0), BIN, 0.002, model) == 0.0


def test_a_hole_takes_the_lowest_of_its_border():
    heights = np.full((5, 6), 0.05)
    heights[1, 4] = 0.03
    heights[2, 3] = np.nan
    filled = fill_unknown_cells(heights, np.ones((5, 6), bool))
    assert filled[2, 3] == 0.03
    filled[2, 3] = heights[2, 3] = 0
    np.testing.assert_array_equal(filled, heights)


def test_cells_that_are_not_trusted_take_their_neighbours_height():
    heights = np.full((4, 4), 0.05)
    heights[0] = 0.12  # the wall's shoulder
    trusted = np.arange(4)[:, None] > np.zeros(4)
    np.testing.assert_array_equal(fill_unknown_cells(heights, trusted), 0.05)


def test_large_holes_fill_up_ring_by_ring_from_their_border():
    """Each cell takes the lowest neighbour among those one step nearer to what is known."""
    random = np.random.default_rng(0)
    heights = random.uniform(0.01, 0.1, (40, 50))
    known = ndimage.distance_transform_edt(random.random((40, 50)) > 0.01) > 4
    filled = fill_unknown_cells(np.where(known, heights, np.nan), np.ones((40, 50), bool))
    steps = ndimage.distance_transform_cdt(~known, "chessboard")
    assert steps.max() >= 3
    expected = np.where(known, heights, np.nan)
    for step in range(1, steps.max() + 1):
        for r, c in np.argwhere(steps == step):
            around = np.s_[max(r - 1, 0):r + 2, max(c - 1, 0):c + 2]
            expected[r, c] = np.min(expected[around][steps[around] == step - 1])
    np.testing.assert_array_equal(filled, expected)


def test_a_map_of_which_nothing_was_seen_is_refused():
    with pytest.raises(ScanError, match="^0 cells of the footprint seen; expected some"):
        fill_unknown_cells(np.full((3, 3), np.nan), np.ones((3, 3), bool))
    with pytest.raises(ScanError, match="^9 cells of the footprint seen"):
        fill_unknown_cells(np.zeros((3, 3)), np.zeros((3, 3), bool))
