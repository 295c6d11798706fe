# SPDX-License-Identifier: Apache-2.0
"""Rotations against scipy's, bit by bit: a last digit of a pose may change a count."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from stack_counter.geometry import rotations


def quaternions(number):
    """Random ones of any norm; of half turns, about the axes, and nearly none."""
    random = np.random.default_rng(0)
    drawn = random.normal(size=(number, 4))
    drawn[::7, 3] = 0
    drawn[1::7] = np.eye(4)[np.arange(len(drawn[1::7])) % 4] * random.choice([-1, 1])
    drawn[2::7, :3] *= 1e-9
    return drawn


def test_matrices_and_quaternions_are_those_of_scipy():
    for quaternion in quaternions(700):
        matrix = Rotation.from_quat(quaternion).as_matrix()
        assert np.array_equal(rotations.matrix_from_quaternion(quaternion), matrix)
        assert np.array_equal(rotations.quaternion_from_matrix(matrix),
                              Rotation.from_matrix(matrix).as_quat(canonical=True))


def test_a_matrix_that_is_rounded_gives_the_nearest_rotation():
    for quaternion in quaternions(100):
        matrix = np.float32(Rotation.from_quat(quaternion).as_matrix()).astype(float)
        assert np.array_equal(rotations.quaternion_from_matrix(matrix),
                              Rotation.from_matrix(matrix).as_quat(canonical=True))


@pytest.mark.parametrize("angle", [1.0, 1e-4, 1e-9, 0.0])
def test_interpolated_rotations_are_those_of_scipy(angle):
    random = np.random.default_rng(1)
    for quaternion in quaternions(200):
        first = Rotation.from_quat(quaternion)
        last = Rotation.from_rotvec(angle * random.normal(size=3)) * first
        for share in (0.0, 1.0, random.uniform()):
            expected = Slerp([0, 1], Rotation.from_matrix([first.as_matrix(), last.as_matrix()]))
            assert np.array_equal(rotations.interpolate_rotation(
                first.as_matrix(), last.as_matrix(), share), expected(share).as_matrix())


def test_a_mirror_image_is_refused():
    with pytest.raises(ValueError, match="determinant -1 .*expected 1"):
        rotations.quaternion_from_matrix(np.diag([1.0, 1, -1]))
