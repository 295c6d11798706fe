# SPDX-License-Identifier: Apache-2.0
"""What an ideal sensor sees of a mesh, against closed forms."""

import numpy as np
import pytest
import trimesh
from kits.analytic import CAMERA, Scene

from stack_counter import geometry
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import Mesh

RADIUS, CENTER = 0.05, np.array([0.02, -0.01, 0.06])


def ball():
    """A ball of triangles, within a hundredth of a millimetre of the round one."""
    mesh = trimesh.creation.icosphere(6, RADIUS)
    return FusedSurface(Mesh((mesh.vertices + CENTER).astype(np.float32),
                             mesh.faces.astype(np.int32)))


@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_heights_of_a_ball(yaw):
    c, s = np.cos(yaw), np.sin(yaw)
    T_world_map = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
                                np.array([-0.04, -0.06, 0.01]))
    got = ball().heights(T_world_map, 0.002, (60, 50))
    assert got.heights.shape == (60, 50) and got.heights.dtype == np.float32
    rows, cols = np.mgrid[:60, :50]
    cells = np.stack([(cols + 0.5) * 0.002, (rows + 0.5) * 0.002, 0 * rows], axis=-1)
    r = np.linalg.norm((geometry.apply(T_world_map, cells) - CENTER)[..., :2], axis=-1)
    np.testing.assert_array_equal(np.isfinite(got.heights)[np.abs(r - RADIUS) > 1e-4],
                                  (r < RADIUS)[np.abs(r - RADIUS) > 1e-4])
    inner = r < 0.9 * RADIUS
    want = CENTER[2] + np.sqrt(RADIUS**2 - r[inner]**2) - 0.01  # above the map's plane
    np.testing.assert_allclose(got.heights[inner], want, atol=5e-5)


def test_depth_of_a_ball():
    T = geometry.look_at(np.array([0.3, 0.2, 0.5]), CENTER)
    got = ball().depth(CAMERA, T)
    want = Scene(plane=False).sphere(CENTER, RADIUS).view(T).depth
    both = (got > 0) & (want > 0)
    assert both.sum() > 0.99 * max((got > 0).sum(), (want > 0).sum())
    assert np.median(np.abs(got - want)[both]) < 1e-5


def test_an_empty_mesh_shows_nothing():
    empty = FusedSurface(Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32)))
    assert np.isnan(empty.heights(np.eye(4), 0.01, (3, 4)).heights).all()
    assert not empty.depth(CAMERA, np.eye(4)).any()
