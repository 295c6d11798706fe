# SPDX-License-Identifier: Apache-2.0
"""A container's inner surface against closed forms, scipy's hulls and trimesh's volumes."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from stack_counter.container.construction import make_container, with_floor
from stack_counter.container.inner_surface import (
    WallTable,
    inside_outline,
    map_rim_opening,
    outline_area,
    wall_mesh,
)
from stack_counter.container.wall_shapes import BoxWall, RoundWall

HEIGHT, WALL, FLOOR, PLANE = 0.12, 0.005, 0.004, 0.3
BOX = BoxWall(np.array([0.1, -0.2, 0.4, 0.3, 0.2, 0.1]))
CONE = RoundWall(np.array([0.1, 0.1, 0.1, 0.2, -0.04]))  # r = R - 0.2 below
SHAPES = pytest.mark.parametrize("shape", [BOX, CONE], ids=lambda s: s.kind)


def container(shape):
    return make_container(shape, WALL, HEIGHT, FLOOR, PLANE)


def hull_volume(box, from_z):
    """Volume inside the inner wall above a height, m3, by trimesh."""
    rings = box.rings[box.rings[:, 0, 2] >= from_z]
    return trimesh.convex.convex_hull(rings.reshape(-1, 3)).volume


def test_the_frame_and_size_of_a_box():
    box = container(BOX)
    assert box.inner_size_m == pytest.approx((0.29, 0.19, HEIGHT - FLOOR))
    np.testing.assert_allclose(box.T_world_container[:3, 3], [0.1, -0.2, PLANE])
    np.testing.assert_allclose(box.T_world_container[:2, 0], [np.cos(0.4), np.sin(0.4)])
    assert box.wall_shape.params == pytest.approx([0, 0, 0, 0.3, 0.2, 0.1])
    assert box.rings[0, :, 2] == pytest.approx(0) and box.rings[-1, :, 2] == pytest.approx(HEIGHT)
    deeper = with_floor(box, 0.02)
    assert deeper.inner_size_m[2] == pytest.approx(0.1) and deeper.floor_thickness_m == 0.02


def test_a_cone_between_its_rings_has_the_volume_of_a_frustum():
    r, R = 0.1 - 0.2 * HEIGHT - WALL, 0.1 - WALL
    frustum = np.pi * HEIGHT / 3 * (r * r + r * R + R * R)
    assert hull_volume(container(CONE), 0.0) == pytest.approx(frustum, rel=1e-3)


@SHAPES
def test_the_map_holds_the_volume_between_floor_and_rim(shape):
    box, pitch = container(shape), 0.001
    opening = map_rim_opening(box, pitch)
    inner, area = opening.inner, opening.area
    assert area == pytest.approx(outline_area(box.rings[-1, :, :2]))
    covered = np.isfinite(inner.heights)
    assert covered.sum() * pitch**2 == pytest.approx(area, rel=0.005)
    # The rings stand 7.5 mm apart; the floor lies between the first two.
    above_second = hull_volume(box, 0.0075 - 1e-9)
    below = outline_area(box.rings[1, :, :2]) * (0.0075 - FLOOR)
    volume = np.nansum(HEIGHT - inner.heights) * pitch**2
    assert volume == pytest.approx(above_second + below, rel=0.005)
    assert np.nanmin(inner.heights) == pytest.approx(FLOOR)


@SHAPES
def test_a_point_is_inside_as_a_convex_hull_says(shape):
    ring = shape.ring(0.0, 0.0)
    points = np.random.default_rng(0).uniform(-0.3, 0.3, (2000, 2)) + shape.center
    want = np.all(points @ (hull := ConvexHull(ring)).equations[:, :2].T
                  + hull.equations[:, 2] < 0, axis=1)
    assert 100 < want.sum() < 1900
    np.testing.assert_array_equal(inside_outline(ring, points), want)


def test_the_table_of_a_cone_gives_the_distance_along_the_radius():
    random = np.random.default_rng(0)
    r, angle = random.uniform(0, 0.12, 500), random.uniform(-np.pi, np.pi, 500)
    z = random.uniform(0, HEIGHT, 500)
    points = np.stack([r * np.cos(angle), r * np.sin(angle), z], axis=1)
    want = 0.1 - 0.2 * (HEIGHT - z) - WALL - r
    np.testing.assert_allclose(WallTable(container(CONE)).depth_inside(points), want, atol=1e-4)


@SHAPES
def test_the_walls_mesh_is_seen_from_inside(shape):
    box = container(shape)
    mesh = wall_mesh(box)
    faces = trimesh.Trimesh(mesh.vertices, mesh.triangles, process=False)
    towards = box.T_world_container[:2, 3] - faces.triangles_center[:, :2]
    assert (np.sum(faces.face_normals[:, :2] * towards, axis=1) > 0).all()
