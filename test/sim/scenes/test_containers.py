# SPDX-License-Identifier: Apache-2.0
"""Containers against closed forms: what the rays see, what the parts touch, what is refused."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import ConvexHull

from stack_counter import geometry
from stack_counter.sim.scenes.containers import KINDS, ContainerError, ContainerShape
from stack_counter.sim.scenes.ray_caster import RayCaster

SIZE, WALL, FLOOR = (0.2, 0.14, 0.1), 0.006, 0.004
CLOSED = [kind for kind in KINDS if kind != "none"]
DRAFT = {"bin": 0.15, "cup": 0.1, "tray": 0.2}


def container(kind, **changes):
    return ContainerShape(kind, **{
        "inner_size_m": SIZE, "wall_thickness_m": WALL, "floor_thickness_m": FLOOR,
        "draft_rad": DRAFT.get(kind, 0.0), "seed": 3, **changes})


def between_rings(box, random, count):
    """Points (count, 3) on the inner wall: on straight lines between neighbouring corners."""
    rings = box.inner_rings
    k, n = random.integers(len(rings) - 1, size=count), random.integers(rings.shape[1], size=count)
    u, w = random.random((2, count, 1))
    low, high = (rings[k + i, n] * (1 - u) + rings[k + i, (n + 1) % rings.shape[1]] * u
                 for i in (0, 1))
    return low * (1 - w) + high * w


def in_any(pieces, points, tolerance):
    """(n,) bool: the points lie in a hull, by more than `tolerance` metres."""
    inside = np.zeros(len(points), bool)
    for piece in pieces:
        faces = ConvexHull(piece).equations
        inside |= (points @ faces[:, :3].T + faces[:, 3] < -tolerance).all(axis=1)
    return inside


@pytest.mark.parametrize("kind", CLOSED)
def test_the_mesh_is_a_closed_body_of_the_sizes_asked_for(kind):
    box = container(kind)
    mesh = box.mesh()
    body = trimesh.Trimesh(mesh.vertices, mesh.triangles)
    assert body.is_volume and body.body_count == 1
    rim, floor = box.inner_rings[-1], box.inner_rings[0]
    np.testing.assert_allclose(np.ptp(rim[:, :2], axis=0), SIZE[:2], rtol=1e-12)
    np.testing.assert_allclose(rim[:, :2].max(axis=0), np.array(SIZE[:2]) / 2, rtol=1e-12)
    assert (rim[:, 2] == box.rim_height_m).all() and box.rim_height_m == pytest.approx(
        SIZE[2] + FLOOR
    )
    assert (floor[:, 2] == FLOOR).all()
    np.testing.assert_allclose(body.bounds[:, 2], [0, box.rim_height_m], atol=1e-7)
    # Whatever lies within the inner wall is inside the container, hence in no wall.
    points = between_rings(box, np.random.default_rng(0), 300) * [0.9, 0.9, 1] + [0, 0, 1e-4]
    assert not RayCaster(mesh).contains(points).any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_rim_opening_is_the_widest_outline(kind):
    box = container(kind)
    assert (np.linalg.norm(box.opening, axis=1)
            >= np.linalg.norm(box.inner_rings[..., :2], axis=2) - 1e-12).all()
    assert box.is_over_opening(box.inner_rings * [1 - 1e-9, 1 - 1e-9, 1]).all()
    x, y = box.opening.T
    assert np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)) > 0, "counter-clockwise"


def test_a_bin_in_closed_form():
    (x, y, depth), box = SIZE, container("bin", draft_rad=0.0)
    mesh = box.mesh()
    np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0),
                               [x + 2 * WALL, y + 2 * WALL, depth + FLOOR], rtol=1e-5)
    want = (x + 2 * WALL) * (y + 2 * WALL) * (depth + FLOOR) - x * y * depth
    assert trimesh.Trimesh(mesh.vertices, mesh.triangles).volume == pytest.approx(want, rel=1e-4)


def test_draft_inclines_the_walls_and_keeps_their_thickness():
    box = container("bin", draft_rad=np.arctan(0.2))
    want = [SIZE[0] - 2 * 0.2 * SIZE[2], SIZE[1] - 2 * 0.2 * SIZE[2]]
    np.testing.assert_allclose(np.ptp(box.inner_rings[0][:, :2], axis=0), want, rtol=1e-12)
    vertices = box.mesh().vertices
    for z, inner in ((box.rim_height_m, SIZE[:2]), (FLOOR, want), (0.0, want)):
        level = vertices[np.abs(vertices[:, 2] - z) < 1e-6]
        outer = np.array(inner) + 2 * WALL
        np.testing.assert_allclose(np.ptp(level, axis=0)[:2], outer, rtol=1e-5)


def test_a_cylinder_and_a_bowl_in_closed_form():
    size = (0.2, 0.2, 0.1)
    rings = container("cylinder", inner_size_m=size).inner_rings
    np.testing.assert_allclose(np.linalg.norm(rings[..., :2], axis=2), 0.1, rtol=1e-12)
    rings = container("bowl", inner_size_m=size).inner_rings
    radius, down = np.linalg.norm(rings[..., :2], axis=2), 1 - (rings[..., 2] - FLOOR) / size[2]
    np.testing.assert_allclose((radius / 0.1) ** 2 + (1 - 0.35**2) * down**2, 1, rtol=1e-9)
    assert radius[0] == pytest.approx(0.035)


@pytest.mark.parametrize("kind", KINDS)
def test_over_opening_in_closed_form(kind):
    points = np.random.default_rng(1).uniform(-0.12, 0.12, (4000, 2))
    got = container(kind).is_over_opening(points)
    if kind in ("cylinder", "bowl", "cup"):  # 48 sides: between two ellipses
        r = np.linalg.norm(points / (np.array(SIZE[:2]) / 2), axis=1)
        sure, want = (r < np.cos(np.pi / 48)) | (r > 1), r < 1
    elif kind == "bag":  # a rounded corner is between a cut-off and a sharp one
        x, y = np.abs(points).T
        beyond = np.array([x - 0.065, y - 0.035])
        r = np.linalg.norm(np.maximum(beyond, 0), axis=0)
        sure, want = np.abs(r - 0.035) > 0.001, r < 0.035
    else:
        sure, want = slice(None), (np.abs(points) < np.array(SIZE[:2]) / 2).all(axis=1)
    np.testing.assert_array_equal(got[sure], want[sure])
    np.testing.assert_array_equal(
        container(kind).is_over_opening(np.pad(points, ((0, 0), (0, 1)))), got
    )


@pytest.mark.parametrize("kind", CLOSED)
def test_collision_leaves_the_inside_free_and_fills_the_wall(kind):
    box, random = container(kind), np.random.default_rng(2)
    pieces = box.collision_pieces()
    assert all(len(piece) >= 8 for piece in pieces)
    wall = between_rings(box, random, 600)
    inside = wall * np.column_stack([*[random.random(600) ** 0.5] * 2, np.ones(600)])
    # A bag's rings are not parallel: the quads between them are bent, by a fraction of a mm.
    assert not in_any(pieces, inside, 5e-4 if kind == "bag" else 1e-9).any()
    out = wall[:, :2] / np.linalg.norm(wall[:, :2], axis=1, keepdims=True)
    assert in_any(pieces, wall + 0.4 * WALL * np.pad(out, ((0, 0), (0, 1))), 0).all()
    # The floor: under all of the inner outline, down to below the support plane.
    under = box.inner_rings[0, random.integers(len(box.opening), size=100)] * [0.9, 0.9, 0]
    assert in_any(pieces, under * random.random((100, 1)) + [0, 0, FLOOR / 2], 0).all()


def test_collision_walls_are_as_thick_at_the_rim_as_those_that_are_seen():
    pieces = container("bin", draft_rad=0.0).collision_pieces()
    top = np.concatenate(pieces)
    top = top[top[:, 2] > FLOOR + SIZE[2] - 1e-9]
    np.testing.assert_allclose(np.ptp(top[:, :2], axis=0), np.array(SIZE[:2]) + 2 * WALL)


def test_collision_walls_grow_outwards_below_the_rim():
    pieces = container("bin", draft_rad=0.0).collision_pieces()
    z = np.linspace(FLOOR, FLOOR + SIZE[2], 20)[1:-1]
    # Farther out by half of what the rim lies higher: in the wall, hence nothing slips through.
    out = SIZE[0] / 2 + WALL + 0.5 * (FLOOR + SIZE[2] - z)
    assert in_any(pieces, np.column_stack([out, 0.01 + 0 * z, z]), 0).all()


def test_a_heap_has_no_body():
    heap = ContainerShape("none", inner_size_m=(0.3, 0.2, 0.0))
    assert heap.mesh() is None and heap.inner_mesh() is None and heap.collision_pieces() == []
    assert heap.rim_height_m == 0 and np.ptp(heap.opening, axis=0) == pytest.approx([0.3, 0.2])


def test_a_bag_is_folded_by_its_seed():
    rings = [container("bag", seed=seed).inner_rings for seed in (3, 3, 4)]
    np.testing.assert_array_equal(rings[0], rings[1])
    assert np.abs(rings[0] - rings[2]).max() > 0.001
    np.testing.assert_array_equal(rings[0][-1], rings[2][-1])  # the rim is not folded


def test_the_meshes_stand_at_the_containers_pose():
    T = geometry.pose(np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]]), np.array([0.3, -0.2, 0]))
    for name in ("mesh", "inner_mesh"):
        still, moved = getattr(container("bag"), name)(), getattr(
            container("bag", T_world_container=T), name)()
        np.testing.assert_allclose(moved.vertices, geometry.apply(T, still.vertices), atol=1e-6)


@pytest.mark.parametrize("kind, changes, reason", [
    ("barrel", {}, "kind is 'barrel'; expected one of"),
    ("bin", {"inner_size_m": (0.2, 0.0, 0.1)}, "expected all above 0"),
    ("bin", {"inner_size_m": (0.2, 0.1, -0.1)}, "expected all above 0"),
    ("cylinder", {"inner_size_m": (np.nan, 0.2, 0.1)}, "expected all above 0"),
    ("cup", {"inner_size_m": (0.2, np.inf, 0.1)}, "expected all above 0"),
    ("bowl", {"wall_thickness_m": 0.0}, "expected all above 0"),
    ("tray", {"wall_thickness_m": np.nan}, "expected all above 0"),
    ("bag", {"floor_thickness_m": -0.001}, "expected all above 0"),
    ("none", {"inner_size_m": (0.0, 0.2, 0.0)}, "expected all above 0"),
    ("bin", {"draft_rad": np.arctan(0.57)}, "draft of 30 degrees closes at its floor"),
    ("bin", {"draft_rad": -0.2}, "draft is -0.2 rad; expected 0 to"),
    ("bin", {"draft_rad": np.nan}, "draft is nan rad; expected 0 to"),
    ("bin", {"floor_thickness_m": np.inf}, "expected all above 0"),
])
def test_what_leaves_no_room_is_refused(kind, changes, reason):
    with pytest.raises(ContainerError, match=reason) as caught:
        container(kind, **changes)
    assert "\n" not in str(caught.value)
