# SPDX-License-Identifier: Apache-2.0
"""Parts of published experiments: volumes against closed forms."""

import numpy as np
import pytest

from stack_counter.sim.reality import parts


@pytest.mark.parametrize("name, volume_of_edge_1", [
    ("tetrahedron", 2**0.5 / 12), ("cube", 1), ("octahedron", 2**0.5 / 3),
    ("dodecahedron", (15 + 7 * 5**0.5) / 4), ("icosahedron", 5 * (3 + 5**0.5) / 12)])
def test_dice_are_platonic_solids(name, volume_of_edge_1):
    die = parts.die(name)
    edges = die.mesh.edges_unique_length[die.mesh.face_adjacency_angles.argsort()]
    assert die.unit_volume == pytest.approx(volume_of_edge_1 * edges.min() ** 3, rel=1e-3)
    assert die.convexity == pytest.approx(1)


def test_ellipsoids_have_the_volume_and_the_proportions():
    lentil = parts.ellipsoid("lentil", 6.72, 6.72, 2.58)
    assert lentil.unit_volume == pytest.approx(np.pi / 6 * 6.72**2 * 2.58e-9, rel=1e-6)
    assert lentil.mesh.extents * 1e3 == pytest.approx([6.72, 6.72, 2.58], rel=0.01)


def test_rings_and_rods_have_the_closed_forms_volume():
    ring = parts.ring("ring", 25, 20, 2)
    assert ring.unit_volume == pytest.approx(np.pi / 4 * (25**2 - 21**2) * 20e-9, rel=1e-6)
    assert parts.ring_of_volume("ring", 25, 1000).unit_volume == pytest.approx(1e-6, rel=0.01)
    assert parts.rod(10).unit_volume == pytest.approx(np.pi * 20e-9, rel=1e-6)


def test_grains_have_the_published_size_and_volume():
    almond = parts.almond(21.19, 14.34, 6.38, 710)
    corn = parts.corn_kernel(9.87, 7.41, 3.25, 167.3)
    for grain, size, volume in ((almond, [14.34, 6.38, 21.19], 710),
                                (corn, [9.87, 7.41, 3.25], 167.3)):
        assert grain.mesh.extents * 1e3 == pytest.approx(size, rel=0.01)
        assert grain.unit_volume * 1e9 == pytest.approx(volume, rel=0.01)
        assert grain.convexity > 0.99


def test_a_toy_brick_has_the_volume_of_its_parts():
    walls = 31.8 * 15.8 * 9.6 - 28.8 * 12.8 * 8.6
    studs = 8 * np.pi * 2.4**2 * 1.7
    tubes = 3 * np.pi / 4 * (6.51**2 - 4.8**2) * 8.6
    assert parts.toy_brick().unit_volume * 1e9 == pytest.approx(walls + studs + tubes, rel=1e-4)
