# SPDX-License-Identifier: Apache-2.0
"""Meshes with fewer triangles: the same surface, in the same colours."""

import numpy as np
import pytest

from stack_counter.display.mesh_decimation import decimate
from stack_counter.types import Mesh

SIDE = 0.3


def sheet(n=100):
    """A square of 2 n^2 triangles with a step in its middle; red left of it, blue right."""
    u, v = np.meshgrid(np.linspace(0, SIDE, n + 1), np.linspace(0, SIDE, n + 1))
    right = u > SIDE / 2
    points = np.stack([u, v, np.where(right, 0.05, 0.0)], -1).reshape(-1, 3).astype(np.float32)
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    triangles = np.concatenate([np.stack([i, i + 1, i + n + 2], 1),
                                np.stack([i, i + n + 2, i + n + 1], 1)]).astype(np.int32)
    colors = np.where(right.reshape(-1, 1), [0, 0, 200], [200, 0, 0]).astype(np.uint8)
    return Mesh(points, triangles, colors)


def doubled_areas(mesh):
    """(m, 3) normals, as long as twice the triangles' areas."""
    a, b, c = (mesh.vertices[mesh.triangles[:, i]].astype(float) for i in range(3))
    return np.cross(b - a, c - a)


@pytest.mark.parametrize("most", [19_999, 5000, 300])
def test_fewer_triangles_cover_the_same_surface(most):
    mesh = sheet()
    fewer = decimate(mesh, most)
    assert most / 4 < len(fewer.triangles) <= most
    normals, before = doubled_areas(fewer), doubled_areas(mesh)
    assert (normals[:, 2] > -1e-12).all()  # all of them face up, as they did
    # A vertex stands for its cell, so that the border moves inwards by up to a cell.
    cell = 2 * SIDE / np.sqrt(len(fewer.triangles) / 2)
    assert normals[:, 2].sum() == pytest.approx(before[:, 2].sum(), abs=2 * 4 * SIDE * cell)
    assert np.abs(np.ptp(fewer.vertices, axis=0) - np.ptp(mesh.vertices, axis=0)).max() < 2 * cell


def test_colours_stay_where_they_were():
    fewer = decimate(sheet(), 2000)
    left = fewer.vertices[:, 2] < 0.001
    right = fewer.vertices[:, 2] > 0.049
    assert left.sum() > 200 and right.sum() > 200
    assert (fewer.colors[left] == [200, 0, 0]).all()
    assert (fewer.colors[right] == [0, 0, 200]).all()
    plain = decimate(Mesh(sheet().vertices, sheet().triangles), 2000)
    assert plain.colors is None
    np.testing.assert_array_equal(plain.vertices, fewer.vertices)


def test_a_mesh_that_is_small_enough_is_not_touched():
    mesh = sheet(10)
    assert decimate(mesh, 200) is mesh
