# SPDX-License-Identifier: Apache-2.0
"""The ten bytes that each pose is stored in."""

import numpy as np
import pytest
from kits.poses import random_poses
from scipy.spatial.transform import Rotation

from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses

HALF = np.sqrt(0.5)
SPECIAL = np.array([[0, 0, 0, 1], [0, 0, 0, -1], [1, 0, 0, 0], [0, -1, 0, 0], [0, 0, 1, 0],
                    [HALF, HALF, 0, 0], [0, -HALF, 0, HALF], [0, 0, HALF, -HALF],
                    [0.5, 0.5, 0.5, 0.5], [-0.5, 0.5, -0.5, 0.5]])


def angles(a, b):
    """(n,) radians between the rotations of two arrays of poses."""
    return (Rotation.from_quat(a[:, 3:]).inv() * Rotation.from_quat(b[:, 3:])).magnitude()


def test_a_pose_takes_ten_bytes_and_comes_back():
    poses = random_poses(1000)
    packed = pack_poses(poses)
    assert packed.positions.nbytes + packed.turns.nbytes == 10 * 1000
    assert packed.frame.nbytes == 24
    back = unpack_poses(packed)
    extent = np.ptp(poses[:, :3], axis=0)
    assert (np.abs(back - poses)[:, :3] <= extent / 65535).all()
    assert np.rad2deg(angles(poses, back)).max() < 0.2
    np.testing.assert_allclose(np.linalg.norm(back[:, 3:], axis=1), 1, rtol=1e-12)


def test_resting_attitudes_come_back():
    poses = np.concatenate([random_poses(len(SPECIAL))[:, :3], SPECIAL], axis=1)
    back = unpack_poses(pack_poses(poses))
    assert np.isfinite(back).all() and np.rad2deg(angles(poses, back)).max() < 0.28


def test_packing_again_changes_nothing():
    poses = np.concatenate([random_poses(5000, seed) for seed in range(20)])
    once = pack_poses(poses)
    again = pack_poses(unpack_poses(once))
    for name in ("frame", "positions", "turns"):
        np.testing.assert_array_equal(getattr(once, name), getattr(again, name))


@pytest.mark.parametrize("count", [0, 1, 2])
def test_few_parts_are_packed_too(count):
    poses = random_poses(count, 5)
    back = unpack_poses(pack_poses(poses))
    assert back.shape == (count, 7)
    np.testing.assert_allclose(back[:, :3], poses[:, :3], atol=1e-5)
