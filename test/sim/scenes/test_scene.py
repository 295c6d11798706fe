# SPDX-License-Identifier: Apache-2.0
"""Scenes: rotation matrices of poses, and the mesh of all parts."""

import numpy as np
import trimesh
from kits.poses import random_poses
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim import Scene
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import rotation_matrices
from stack_counter.sim.shapes import Shape


def test_rotations_are_those_of_scipy():
    poses = random_poses(100)
    want = Rotation.from_quat(poses[:, 3:]).as_matrix()
    np.testing.assert_allclose(rotation_matrices(poses), want, atol=1e-12)
    assert rotation_matrices(np.zeros((0, 7))).shape == (0, 3, 3)


def test_parts_lie_in_the_containers_frame():
    part = trimesh.creation.box([0.03, 0.02, 0.01])
    shape = Shape("test", np.array(part.vertices), np.asarray(part.faces, np.int32))
    c, s = np.cos(0.8), np.sin(0.8)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([0.3, -0.2, 0]))
    poses = random_poses(4)
    mesh = Scene(0, 0, shape, ContainerShape("none", T, (1.0, 1.0, 0.0)), poses).parts_mesh()
    for i, pose in enumerate(poses):
        local = Rotation.from_quat(pose[3:]).apply(shape.vertices) + pose[:3]
        part_i = mesh.vertices[8 * i:8 * i + 8]
        np.testing.assert_allclose(part_i, geometry.apply(T, local), atol=1e-6)
        np.testing.assert_array_equal(mesh.triangles[12 * i:12 * i + 12], shape.faces + 8 * i)
