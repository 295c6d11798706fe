# SPDX-License-Identifier: Apache-2.0
"""Up is the normal of the plane that all stands on, on the side of the cameras."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.bag.upright import find_upright_pose

CAMERAS = np.array([geometry.look_at(np.array([0.5 * np.cos(a), 0.5 * np.sin(a), 0.4]),
                                     np.zeros(3)) for a in np.arange(6)])


def scene(random, ground=500):
    """A noisy ground at z = 0, a level top at 0.1 with more points than it, and walls."""
    top = random.uniform(-0.1, 0.1, (ground + 200, 3)) * [1, 1, 0] + [0, 0, 0.1]
    walls = random.uniform(-0.1, 0.1, (300, 3)) * [1, 0, 0.5] + [0, 0.1, 0.05]
    plane = random.uniform(-0.4, 0.4, (ground, 3)) * [1, 1, 0]
    return np.concatenate([plane, top, walls]) + random.normal(0, 0.0005, (2 * ground + 500, 3))


def test_the_lowest_plane_is_level_and_at_zero_however_the_world_is_turned():
    random = np.random.default_rng(0)
    points = scene(random)
    T = geometry.pose(Rotation.from_euler("xyz", [2.0, -0.7, 0.3]).as_matrix(), [3.0, -1, 2])
    found = find_upright_pose(geometry.apply(T, points), T @ CAMERAS)
    assert found.support_share == pytest.approx(500 / 1500, abs=0.03)
    upright = found.T_upright_world @ T
    assert upright[2, :3] == pytest.approx([0, 0, 1], abs=2e-3)
    assert geometry.apply(upright, points)[:500, 2] == pytest.approx(0, abs=3e-3)
    assert np.linalg.det(found.T_upright_world[:3, :3]) == pytest.approx(1)


def test_without_a_plane_up_is_that_of_the_pictures():
    points = np.random.default_rng(0).normal(size=(500, 3)) * 0.1
    found = find_upright_pose(points, CAMERAS)
    assert found.support_share == 0
    assert found.T_upright_world[2, :3] == pytest.approx([0, 0, 1], abs=0.1)
