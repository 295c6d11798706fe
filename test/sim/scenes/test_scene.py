"""Scenes: rotations, the mesh of all parts, and the ten bytes of a pose."""

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim import Scene
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import pack, rotations, unpack
from stack_counter.sim.shapes import Shape

HALF = np.sqrt(0.5)
SPECIAL = np.array([[0, 0, 0, 1], [0, 0, 0, -1], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0],
                    [HALF, HALF, 0, 0], [0, -HALF, 0, HALF], [0, 0, HALF, -HALF],
                    [0.5, 0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])


def random_poses(count, seed=0):
    random = np.random.default_rng(seed)
    return np.concatenate([random.uniform([-0.2, -0.1, 0.001], [0.2, 0.15, 0.3], (count, 3)),
                           Rotation.random(count, random_state=seed).as_quat()], axis=1)


def angles(a, b):
    """(n,) radians between the rotations of two arrays of poses."""
    return (Rotation.from_quat(a[:, 3:]).inv() * Rotation.from_quat(b[:, 3:])).magnitude()


def test_rotations_are_those_of_scipy():
    poses = random_poses(100)
    np.testing.assert_allclose(rotations(poses), Rotation.from_quat(poses[:, 3:]).as_matrix(),
                               atol=1e-12)
    assert rotations(np.zeros((0, 7))).shape == (0, 3, 3)


def test_a_pose_takes_ten_bytes_and_comes_back():
    poses = random_poses(1000)
    frame, positions, turns = packed = pack(poses)
    assert positions.nbytes + turns.nbytes == 10 * 1000 and frame.nbytes == 24
    back = unpack(*packed)
    extent = np.ptp(poses[:, :3], axis=0)
    assert (np.abs(back - poses)[:, :3] <= extent / 65535).all()
    assert np.rad2deg(angles(poses, back)).max() < 0.2
    np.testing.assert_allclose(np.linalg.norm(back[:, 3:], axis=1), 1, rtol=1e-12)


def test_resting_attitudes_come_back():
    poses = np.concatenate([random_poses(len(SPECIAL))[:, :3], SPECIAL], axis=1)
    back = unpack(*pack(poses))
    assert np.isfinite(back).all() and np.rad2deg(angles(poses, back)).max() < 0.28


def test_packing_again_changes_nothing():
    poses = np.concatenate([random_poses(5000, seed) for seed in range(20)])
    once = pack(poses)
    for a, b in zip(once, pack(unpack(*once))):
        np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_parts_are_packed_too(count):
    poses = random_poses(count, 5)
    back = unpack(*pack(poses))
    assert back.shape == (count, 7)
    np.testing.assert_allclose(back[:, :3], poses[:, :3], atol=1e-5)


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
