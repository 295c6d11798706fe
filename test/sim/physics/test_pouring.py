# SPDX-License-Identifier: Apache-2.0
"""Pouring: parts are born apart, inside the column, and flat faces rest at any friction."""

import manifold3d
import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.engine import PileSimulation
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import rotation_matrices
from stack_counter.sim.shapes import shape_from_mesh

pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")


def box(*sides):
    return trimesh.creation.box(sides)


THIN_PARTS = {
    "ring": trimesh.creation.annulus(0.46, 0.5, 1.0, sections=24),
    "tube": trimesh.creation.annulus(0.12, 0.15, 1.0, sections=16),
    "frame": trimesh.boolean.difference([box(1, 0.8, 0.1), box(0.9, 0.7, 0.2)], engine="manifold"),
}


def born(mesh, column, count, seed):
    """(n, 7) poses in part sizes in which parts are born over a container of that column."""
    shape = shape_from_mesh(mesh.vertices, mesh.faces, "thin", part_size=1.0 / 40)
    size = shape.part_size
    container = ContainerShape("bin", np.eye(4), (10 * size, 10 * size, 2 * size), size, size)
    plan = PilePlan(shape, container, np.array(column) * size, count)
    pile = PileSimulation(plan, [shape.mesh.convex_hull.vertices], np.random.default_rng(seed))
    pile._run = lambda seconds: None  # where they are born, not where they fall
    pile.pour()
    return shape.vertices / size, shape.faces, pile.poses()


@pytest.mark.parametrize("part", THIN_PARTS)
@pytest.mark.parametrize("column", [(1, 1), (2.9, 4.4), (5, 5)])
def test_no_two_parts_are_born_through_each_other(part, column):
    vertices, faces, poses = born(THIN_PARTS[part], column, 90, seed=len(part))
    meshes = [manifold3d.Manifold(manifold3d.Mesh(
        (vertices @ R.T + p).astype(np.float32), faces.astype(np.uint32)))
        for R, p in zip(rotation_matrices(poses), poses[:, :3])]
    reach = 2 * np.linalg.norm(vertices, axis=1).max()
    near = cKDTree(poses[:, :3]).query_pairs(1.5 * reach)
    assert len(near) >= 89, "neighbours were compared"
    assert max((meshes[i] ^ meshes[j]).volume() for i, j in near) == 0


def test_the_places_fill_the_column():
    column = np.array([3.3, 4.7])  # spare room for half a part and more
    vertices, _, poses = born(THIN_PARTS["ring"], column, 400, seed=1)
    radius = np.linalg.norm(vertices, axis=1).max()
    reach = np.abs(poses[:, :2]) + radius
    assert (reach <= column / 2 + 1e-6).all(), "whole parts are inside"
    assert (reach.max(axis=0) > column / 2 - 0.05).all(), "up to its sides"


def test_cubes_come_to_rest_at_the_lowest_friction():
    mesh = box(0.02, 0.02, 0.02)
    cube = shape_from_mesh(mesh.vertices, mesh.faces, "cube")
    container = ContainerShape("bin", np.eye(4), (0.1, 0.1, 0.1), 0.002, 0.002)
    scene = simulate_pile(PilePlan(cube, container, np.array([0.095, 0.095]), 60, friction=0.05),
                          np.random.default_rng(0))
    assert scene.truth.count >= 57 and 0.55 < scene.truth.gamma < 0.9
