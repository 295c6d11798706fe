# SPDX-License-Identifier: Apache-2.0
"""Lines of cameras, boxes and containers, against their corners."""

import numpy as np
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.display.wireframes import box_lines, container_lines, frustum_lines
from stack_counter.types import Container, Intrinsics

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
T = geometry.pose(Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix(), np.array([0.1, -0.2, 0.7]))


def ends(lines):
    """The lines as a set of pairs, whichever end comes first."""
    return {frozenset(map(tuple, line.round(9).tolist())) for line in lines}


def test_a_frustum_has_its_tip_at_the_camera_and_its_base_around_the_image():
    base = [(-0.032, -0.024, 0.06), (0.032, -0.024, 0.06), (0.032, 0.024, 0.06),
            (-0.032, 0.024, 0.06)]
    expected = {frozenset([(0.0, 0.0, 0.0), corner]) for corner in base}
    expected |= {frozenset([a, b]) for a, b in zip(base, base[1:] + base[:1])}
    lines = frustum_lines(CAMERA, np.eye(4), 0.06)
    assert ends(lines) == expected
    np.testing.assert_allclose(frustum_lines(CAMERA, T, 0.06), geometry.apply(T, lines))


def test_a_frustum_of_a_crop_ends_where_the_crop_does():
    low, high = np.array([100, 200]), np.array([399, 439])
    whole, part = geometry.project(frustum_lines(CAMERA, np.eye(4), 1.0), CAMERA)[0], None
    crop = Intrinsics(300, 240, 600.0, 600.0, 319.5 - 100, 239.5 - 200)
    part = geometry.project(frustum_lines(crop, np.eye(4), 1.0)[4:], CAMERA)[0]
    np.testing.assert_allclose(part.reshape(-1, 2).min(axis=0), low - 0.5)
    np.testing.assert_allclose(part.reshape(-1, 2).max(axis=0), high + 0.5)
    np.testing.assert_allclose(whole[4:].reshape(-1, 2).max(axis=0), [639.5, 479.5])


def test_a_box_has_four_edges_along_each_axis():
    low, high = np.array([-0.1, 0.2, 0.0]), np.array([0.3, 0.5, 0.2])
    lines = box_lines(low, high)
    assert len(ends(lines)) == 12
    along = np.abs(lines[:, 1] - lines[:, 0])
    np.testing.assert_allclose(along.sum(axis=0), 4 * (high - low))
    assert (np.count_nonzero(along > 1e-9, axis=1) == 1).all()
    assert {tuple(p) for p in lines.reshape(-1, 3).tolist()} == {
        (x, y, z) for x in (-0.1, 0.3) for y in (0.2, 0.5) for z in (0.0, 0.2)}


def test_a_container_shows_floor_rim_and_walls_in_the_world():
    square = np.array([[1.0, 1], [-1, 1], [-1, -1], [1, -1]]) * [0.1, 0.08]
    rings = np.stack([np.column_stack([square, np.full(4, z)]) for z in (0.0, 0.01, 0.12)])
    box = Container("box", T, (0.2, 0.16, 0.11), 0.005, 0.01, rings)
    lines = geometry.apply(geometry.inverse(T), container_lines(box))
    expected = {frozenset([tuple(ring[i]), tuple(ring[(i + 1) % 4])])
                for ring in rings[1:].round(9).tolist() for i in range(4)}
    expected |= {frozenset([tuple(a), tuple(b)]) for a, b in zip(*rings[1:].round(9).tolist())}
    assert ends(lines) == expected  # and nothing below the floor
    assert container_lines(Container("none", T)).shape == (0, 2, 3)
