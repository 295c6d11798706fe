# SPDX-License-Identifier: Apache-2.0
"""Which parts show from above: boxes beside and upon each other, in closed form."""

import numpy as np
import pytest
from kits.cubes import SIDE, cubes

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.sim import ideal_surface, match_parts, parts_from_above, surface_grid


def test_a_cube_that_lies_free_shows_whole_where_it_is():
    scene = cubes((0, 0, 0.5), (2, 1, 0.5))
    parts = parts_from_above(scene)
    assert parts.numbers.shape == ideal_surface(scene).top.shape
    assert parts.shares == pytest.approx([1, 1])
    assert parts.cell_counts == pytest.approx([PIXELS_PER_LENGTH**2] * 2, abs=PIXELS_PER_LENGTH)
    places = surface_grid(scene).world_xy(scene.container.T_world_container, parts.centers)
    pixel = SIDE / PIXELS_PER_LENGTH
    assert places == pytest.approx(np.array([[0.3, -0.2], [0.34, -0.18]]), abs=pixel)


def test_what_lies_upon_a_part_takes_of_its_share():
    scene = cubes((0, 0, 0.5), (0.5, 0, 1.5), (0.5, 3, 0.5))
    lower, upper, free = parts_from_above(scene).shares
    assert lower == pytest.approx(0.5, abs=0.08) and upper == free == pytest.approx(1)


def test_parts_that_are_covered_are_not_among_them():
    parts = parts_from_above(cubes((0, 0, 0.5), (0, 0, 1.5), kind="bin"))
    assert len(parts.shares) == 1 and parts.numbers.max() == 0
    assert parts.numbers.min() == -1  # the floor


def test_each_true_part_is_found_once():
    true = np.array([[0.0, 0.0], [0.0, 1.0], [9.0, 9.0]])
    found = np.array([[0.0, 0.9], [0.0, 0.8], [5.0, 5.0], [0.1, 0.0]])
    assert match_parts(found, true, 0.95).tolist() == [1, 0, -1, -1]
    assert match_parts(found, true, 0.5).tolist() == [1, -1, -1, 0]
    assert match_parts(found[:0], true, 1.0).tolist() == []
    assert match_parts(found, true[:0], 1.0).tolist() == [-1] * 4
