# SPDX-License-Identifier: Apache-2.0
"""True overlap: walls through each other are found, walls that touch are not."""

from collections import Counter

import numpy as np
import pytest
import trimesh

from stack_counter.sim.physics.true_overlap import SETTINGS, count_crossings, mean_wall
from stack_counter.sim.shapes import shape_from_mesh

SIZE = 0.03
RING = trimesh.creation.annulus(0.45, 0.5, 0.3, sections=48)
ring = shape_from_mesh(RING.vertices, RING.faces, "ring", part_size=SIZE)
UPRIGHT = [np.sqrt(0.5), 0, 0, np.sqrt(0.5)]  # x, y, z, w: a quarter turn about x
FLAT = [0, 0, 0, 1]


def poses(*places):
    """Poses from ((x, y, z) in part sizes, quaternion)."""
    return np.array([[*(np.array(place) * SIZE), *turn] for place, turn in places], float)


def test_the_mean_wall_of_a_wide_plate_is_its_thickness():
    plate = trimesh.creation.box([1, 1, 0.01])
    shape = shape_from_mesh(plate.vertices, plate.faces, "plate", part_size=SIZE)
    assert mean_wall(shape) == pytest.approx(0.01 / 1.02, rel=1e-6)


@pytest.mark.parametrize("place, turn", [
    ((0.95, 0, 0), UPRIGHT),  # one ring's wall lies in that of the other
    ((0.93, 0.1, 0.05), UPRIGHT),
    ((0.3, 0.0, 0.05), FLAT),  # two rings side by side, through each other
])
def test_crossed_rings_are_found(place, turn):
    assert count_crossings(ring, poses(((0, 0, 0), FLAT), (place, turn))) == 1


@pytest.mark.parametrize("place, turn", [
    ((1.0, 0, 0), FLAT),  # side by side
    ((0, 0, 0.3), FLAT),  # one on the other
    ((0, 0, 0.297), FLAT),  # pressed in by a tenth of the wall, as contacts are
    ((1.0, 0, 0), UPRIGHT),
    ((0.5, 0, 0), UPRIGHT),  # through its hole
    ((0.2, 0, 0.5 + 0.15), UPRIGHT),
    ((2, 2, 0), FLAT),
])
def test_rings_that_touch_have_not_crossed(place, turn):
    assert count_crossings(ring, poses(((0, 0, 0), FLAT), (place, turn))) == 0


def test_pairs_are_counted_once_each():
    chain = poses(((0, 0, 0), FLAT), ((0.95, 0, 0), UPRIGHT), ((3, 0, 0), FLAT),
                  ((3.95, 0, 0), UPRIGHT), ((6, 0, 0), FLAT))
    assert count_crossings(ring, chain) == 2
    assert count_crossings(ring, chain[::-1]) == 2
    assert count_crossings(ring, chain[:1]) == count_crossings(ring, chain[:0]) == 0


def test_solid_parts_are_not_looked_at():
    ball = trimesh.creation.icosphere(2)
    shape = shape_from_mesh(ball.vertices, ball.faces, "ball", part_size=SIZE)
    assert mean_wall(shape) > SETTINGS.thin_below
    assert count_crossings(shape, poses(((0, 0, 0), FLAT), ((0.1, 0, 0), FLAT))) == 0


def test_a_pile_with_crossed_walls_is_thrown_away_and_counted(monkeypatch):
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    from kits.recipes import Few

    from stack_counter.sim.physics.drop import make_scene
    from stack_counter.sim.shapes import make_shape

    found = iter([2, 0])
    monkeypatch.setattr("stack_counter.sim.physics.drop.count_crossings", lambda *_: next(found))
    failed = Counter()
    make_scene(0, 0, Few(library=(make_shape(0, "block"),)), failed)
    assert failed == {"crossed walls": 1}
