# SPDX-License-Identifier: Apache-2.0
"""What is known of a part's form: measures of a mesh in closed form, and its levels."""

import numpy as np
import pytest
import trimesh

from stack_counter.occupancy.known_form import (
    KNOWN_VALUES,
    KnownForm,
    KnownLevel,
    form_of_mesh,
    hide_above,
    known_values,
)


def test_a_brick_has_the_measures_of_the_formulas():
    brick = trimesh.creation.box((0.032, 0.016, 0.01))
    turned = brick.vertices @ trimesh.transformations.random_rotation_matrix()[:3, :3] + 0.1
    form = form_of_mesh(turned, brick.faces)
    assert form.outer_size_m == pytest.approx((0.032, 0.016, 0.01), rel=1e-4)
    assert form.mesh.solidity == pytest.approx(1)
    assert form.mesh.surface_m2 == pytest.approx(2 * (32 * 16 + 32 * 10 + 16 * 10) * 1e-6)
    assert form.mesh.genus == 0
    assert form.mesh.gyration_m == pytest.approx(np.array([0.032, 0.016, 0.01]) / 12**0.5)


def test_a_square_plate_measures_the_same_however_it_is_drawn():
    plate = trimesh.creation.box((0.02, 0.02, 0.005))
    for degrees in (0, 20, 45):
        turn = trimesh.transformations.rotation_matrix(np.deg2rad(degrees), [0, 0, 1])
        size = form_of_mesh(plate.vertices @ turn[:3, :3], plate.faces).outer_size_m
        assert size == pytest.approx((0.02, 0.02, 0.005), rel=1e-4)


def test_a_ring_has_one_hole_and_is_not_solid():
    ring = trimesh.creation.annulus(0.01, 0.02, 0.005)
    mesh = form_of_mesh(ring.vertices, ring.faces).mesh
    assert mesh.genus == 1 and mesh.solidity == pytest.approx(0.75, abs=0.01)


def test_values_do_not_depend_on_the_unit_of_length():
    ring = trimesh.creation.annulus(0.01, 0.02, 0.005)
    one, two = (known_values(form_of_mesh(s * ring.vertices, ring.faces), s**3 * ring.volume)
                for s in (1, 3))
    np.testing.assert_allclose(one, two, atol=1e-5)
    # v over the box is the reciprocal of the product of the outer dimensions. The faceted ring
    # fits into a box 1% smaller than along its axes.
    assert np.exp(-one[:3].sum()) == pytest.approx(ring.volume / np.prod(ring.extents), rel=0.02)


def test_levels_hide_what_lies_above_them():
    ring = trimesh.creation.annulus(0.01, 0.02, 0.005)
    form = form_of_mesh(ring.vertices, ring.faces)
    values = known_values(form, ring.volume)
    assert form.level is KnownLevel.MESH and values.shape == (KNOWN_VALUES,)
    np.testing.assert_array_equal(hide_above(values, KnownLevel.MESH), values)
    size = KnownForm(form.outer_size_m)
    assert size.level is KnownLevel.SIZE
    np.testing.assert_array_equal(hide_above(values, KnownLevel.SIZE),
                                  known_values(size, ring.volume))
    assert KnownForm().level is KnownLevel.VOLUME
    assert not hide_above(values, KnownLevel.VOLUME).any()
    assert not known_values(KnownForm(), ring.volume).any()
