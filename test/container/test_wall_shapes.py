# SPDX-License-Identifier: Apache-2.0
"""Wall shapes against closed forms: areas, distances, normals, frames."""

import numpy as np
import pytest

from stack_counter.container.inner_surface import outline_area
from stack_counter.container.placement import PlacedWall
from stack_counter.container.wall_shapes import (
    BoxWall,
    FreeWall,
    RoundWall,
    fourier_basis,
    rotation_2d,
)

BOX = BoxWall(np.array([0.1, -0.2, 0.4, 0.3, 0.2, 0.1]))
ROUND = RoundWall(np.array([-0.1, 0.05, 0.12, 0.2, 0.3]))
RADII = np.zeros(17)
RADII[[0, 2, 11]] = 0.12, 0.012, -0.008  # mean, cosine of twice, sine of thrice the angle
FREE = FreeWall.from_outline(np.array([0.2, 0.1]), RADII)
LEANING = FREE.with_params(FREE.params + 0.1 * (np.arange(27) == 17))
PLACED = PlacedWall(np.array([0.3, -0.1, 2.0]), BOX.in_own_frame())
SHAPES = {"box": BOX, "round": ROUND, "free": FREE, "leaning": LEANING, "placed": PLACED}
RANDOM = np.random.default_rng(0)


def around(shape, count=400):
    """Points within 4 cm of a shape's rim, and depths below it."""
    rim = shape.ring(0.0, 0.0)
    corner, share = RANDOM.integers(0, len(rim), count), RANDOM.uniform(0, 1, (count, 1))
    side = rim[corner] + share * (np.roll(rim, -1, axis=0)[corner] - rim[corner])
    return side + RANDOM.uniform(-0.03, 0.03, (count, 2)), RANDOM.uniform(0, 0.1, count)


@pytest.mark.parametrize("below, inwards", [(0.0, 0.0), (0.08, 0.0), (0.05, 0.004)])
def test_a_ring_has_the_area_of_its_closed_form(below, inwards):
    a, b = BOX.params[3:5] - 2 * (inwards + 0.1 * below)
    assert outline_area(BOX.ring(below, inwards)) == pytest.approx(a * b)
    r = np.sqrt(0.12**2 - 2 * 0.2 * 0.12 * below - 0.3 * below**2) - inwards
    assert outline_area(ROUND.ring(below, inwards)) == pytest.approx(np.pi * r**2)


def test_a_free_outline_has_the_area_of_its_coefficients():
    """Half the integral of r^2: a polygon of 90 corners lacks a thousandth of it."""
    area = np.pi * (0.12**2 + (0.012**2 + 0.008**2) / 2)
    assert outline_area(FREE.ring(0.0, 0.0)) == pytest.approx(area, rel=3e-3)
    assert outline_area(FREE.ring(0.05, 0.0)) == pytest.approx(area, rel=3e-3)  # upright


@pytest.mark.parametrize("name", SHAPES)
def test_a_ring_lies_as_far_inside_as_it_was_moved(name):
    shape, below = SHAPES[name], 0.04
    ring = shape.ring(below, 0.005)
    inside = shape.depth_inside(ring, np.full(len(ring), below))
    # A round ring's corners lie a little outside of the circle whose area it has.
    np.testing.assert_allclose(inside, 0.005, atol=1e-4 if name == "round" else 1e-9)


@pytest.mark.parametrize("name", ["box", "round", "placed"])
def test_normals_are_the_gradient_of_the_distance(name):
    shape = SHAPES[name]
    xy, below = around(shape)
    step, gradient = 1e-6, []
    for axis in np.eye(2) * step:
        gradient.append((shape.depth_inside(xy + axis, below)
                         - shape.depth_inside(xy - axis, below)) / (2 * step))
    gradient = np.stack(gradient, axis=1)
    smooth = np.abs(np.linalg.norm(gradient, axis=1) - 1) < 1e-6  # no corner within the step
    assert smooth.mean() > 0.98
    np.testing.assert_allclose(shape.outward_normals(xy)[smooth], -gradient[smooth], atol=1e-5)


@pytest.mark.parametrize("name", ["free", "leaning"])
def test_a_free_walls_distance_grows_as_fast_as_one_walks_to_it(name):
    shape = SHAPES[name]
    rim = shape.ring(0.0, 0.0)
    along = np.roll(rim, -1, axis=0) - np.roll(rim, 1, axis=0)
    normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    inside = shape.depth_inside(rim - 0.002 * normal, np.zeros(len(rim)))
    np.testing.assert_allclose(inside, 0.002, rtol=0.02)
    assert np.sum(normal * shape.outward_normals(rim), axis=1).min() > 0.9


@pytest.mark.parametrize("name", SHAPES)
def test_moved_inwards_by_so_much_it_is_so_much_nearer(name):
    shape = SHAPES[name]
    xy, _ = around(shape)
    moved, level = shape.offset_inwards(0.003), np.zeros(len(xy))
    assert type(moved) is type(shape)
    # All radii of a free wall are cut by so much, which is more than along its normals.
    np.testing.assert_allclose(moved.depth_inside(xy, level),
                               shape.depth_inside(xy, level) - 0.003,
                               atol=4e-4 if shape.kind == "free" else 1e-9)


@pytest.mark.parametrize("name", SHAPES)
def test_in_its_own_frame_it_is_the_same_shape(name):
    shape = SHAPES[name]
    xy, below = around(shape)
    local = (xy - shape.center) @ rotation_2d(shape.yaw)
    own = shape.in_own_frame()
    assert own.yaw == 0 and not own.center.any() and own.kind == shape.kind
    np.testing.assert_allclose(own.depth_inside(local, below), shape.depth_inside(xy, below),
                               atol=1e-12)


def test_a_placed_box_is_the_box_of_that_pose():
    box = BoxWall(np.array([0.3, -0.1, 2.0, *BOX.params[3:]]))
    np.testing.assert_allclose(PLACED.ring(0.03, 0.002), box.ring(0.03, 0.002), atol=1e-12)
    xy, below = around(box)
    np.testing.assert_allclose(PLACED.outward_normals(xy), box.outward_normals(xy), atol=1e-12)


@pytest.mark.parametrize("name", SHAPES)
def test_every_parameter_has_a_prior(name):
    shape = SHAPES[name]
    assert shape.prior_std.shape == shape.params.shape and (shape.prior_std > 0).all()


def test_the_basis_is_orthogonal_over_the_circle():
    basis = fourier_basis(2 * np.pi * np.arange(64) / 64, 5)
    np.testing.assert_allclose(basis.T @ basis, np.diag([64, *[32] * 10]), atol=1e-9)
