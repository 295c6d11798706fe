# SPDX-License-Identifier: Apache-2.0
"""The published rule on shapes of known volume."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter.eval.common.published_rule import (
    RELEASED,
    WRITTEN,
    Grid,
    removal_votes,
    removal_votes_by_loop,
    volume_by_rule,
)
from stack_counter.types import CONTAINER, Intrinsics

CUBE = 0.1
CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (0, 2)]) * CUBE / 2
SMALL = Intrinsics(320, 240, 305.0, 305.0, 159.5, 119.5)


def views_of(solid, count=24, camera=SMALL):
    """Views of a solid alone in space; labels as the depth says, and a far background."""
    views = solid.views(count, center=(0, 0, CUBE / 2), tilts=(15, 40, 65, 90), camera=camera)
    return [replace(v, labels=np.where(v.depth > 0, CONTAINER, 0).astype(np.uint8))
            for v in views]


@pytest.fixture(scope="module")
def cube():
    return views_of(Scene(plane=False).box([0, 0, CUBE / 2], [CUBE] * 3))


@pytest.mark.parametrize("rule", [WRITTEN, RELEASED], ids=["written", "released"])
def test_hull_of_a_cube(cube, rule):
    grid = Grid.around(CORNERS, 50)
    assert volume_by_rule(cube, grid, 0.0, rule) == pytest.approx(CUBE**3, rel=0.05)


def test_walls_as_written_leave_the_inside(cube):
    """On five sides, a wall of five voxels."""
    grid = Grid.around(CORNERS, 50)
    side = grid.sides[0]
    wall = 5 * side
    inside = (CUBE - 2 * wall)**2 * (CUBE - wall)
    assert volume_by_rule(cube, grid, wall, WRITTEN) == pytest.approx(inside, rel=0.05)


def test_walls_as_released_lose_half_their_thickness(cube):
    grid = Grid.around(CORNERS, 50)
    wall = 5 * grid.sides[0]
    half = (CUBE - wall)**2 * (CUBE - wall / 2)
    assert volume_by_rule(cube, grid, wall, RELEASED) == pytest.approx(half, rel=0.07)


def test_an_open_bin_is_not_filled_to_its_rim():
    """The depth images carve what the masks cannot: a bin filled to a third."""
    inner, wall, fill = (0.1, 0.1, 0.06), 0.006, 0.02
    views = views_of(Scene(plane=False).bin(inner, wall, wall, fill), 24)
    corner = np.array([0.05 + wall, 0.05 + wall, 0.06 + wall])
    grid = Grid.around(np.array([corner * [-1, -1, 0], corner]), 60)
    assert volume_by_rule(views, grid, wall, WRITTEN) == pytest.approx(0.1 * 0.1 * fill, rel=0.15)


def test_votes_beside_the_image_are_none_and_the_loop_votes_alike(cube):
    points = np.concatenate([Grid.around(CORNERS * 1.5, 12).centers(),
                             [[5.0, 0, 0], [0, 0, 50.0]]])
    votes = removal_votes(cube[0], points)
    assert 0 < votes.sum() < len(votes)
    assert not votes[-2:].any()
    assert np.array_equal(votes, removal_votes_by_loop(cube[0], points))


def test_more_votes_leave_more(cube):
    grid = Grid.around(CORNERS, 20)
    left = [volume_by_rule(cube, grid, 0.0, replace(RELEASED, votes=n)) for n in (1, 5, 25)]
    assert left[0] <= left[1] < left[2] == pytest.approx(np.prod(grid.sides) * 20**3)
