# SPDX-License-Identifier: Apache-2.0
"""Quaternions and rotation matrices, bit by bit as scipy's `Rotation` gives them.

Every node reads poses, and loading scipy.spatial takes longer than all the rest of the collector.
Quaternions are (4,) float64, x, y, z, w; matrices (3, 3).
"""

from __future__ import annotations

import math

import numpy as np

_SMALL_ANGLE = 1e-3  # radians, below which sines are replaced by their series


def matrix_from_quaternion(quaternion: np.ndarray) -> np.ndarray:
    """Returns the (3, 3) matrix of a quaternion of any norm but 0."""
    return _matrix_of(_normalized(quaternion.tolist()))


def quaternion_from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Returns the quaternion, w >= 0, of the rotation nearest to a (3, 3) matrix.

    Raises:
        ValueError: the matrix is no rotation's but a mirror image's.
    """
    q = np.array(_quaternion_of(matrix))
    # Of the two quaternions of a half turn, the one whose first number that is not 0 is positive.
    x, y, z, w = q
    return -q if (w, x, y, z) < (0, 0, 0, 0) else q


def interpolate_rotation(matrix_a: np.ndarray, matrix_b: np.ndarray, share: float) -> np.ndarray:
    """Returns the (3, 3) rotation at `share` (0 to 1) of the way from one to the other (slerp).

    Raises:
        ValueError: as for `quaternion_from_matrix`.
    """
    a, b = _quaternion_of(matrix_a), _quaternion_of(matrix_b)
    turn = [share * r for r in _rotation_vector(_product([-a[0], -a[1], -a[2], a[3]], b))]
    return _matrix_of(_product(a, _from_rotation_vector(turn)))


def _matrix_of(q: list[float]) -> np.ndarray:
    """Returns the (3, 3) matrix of a quaternion of norm 1."""
    x, y, z, w = q
    xx, yy, zz, ww = x * x, y * y, z * z, w * w
    return np.array([[xx - yy - zz + ww, 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), -xx + yy - zz + ww, 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), -xx - yy + zz + ww]])


def _quaternion_of(matrix: np.ndarray) -> list[float]:
    """Returns a quaternion of a (3, 3) matrix by its largest component.

    Raises:
        ValueError: as for `quaternion_from_matrix`.
    """
    if np.linalg.det(matrix) <= 0:
        raise ValueError(f"determinant {np.linalg.det(matrix):.3g} of a rotation matrix; expected "
                         "1: axes that form a right-handed frame")
    if not np.isclose(matrix @ matrix.T, np.eye(3), atol=1e-12).all():
        u, _, vt = np.linalg.svd(matrix[None])
        matrix = (u @ vt)[0]
    m = matrix.tolist()
    trace = m[0][0] + m[1][1] + m[2][2]
    sizes = [m[0][0], m[1][1], m[2][2], trace]
    i = sizes.index(max(sizes))
    if i == 3:
        return _normalized([m[2][1] - m[1][2], m[0][2] - m[2][0], m[1][0] - m[0][1], 1 + trace])
    j, k = (i + 1) % 3, (i + 2) % 3
    q = [0.0, 0.0, 0.0, m[k][j] - m[j][k]]
    q[i], q[j], q[k] = 1 - trace + 2 * m[i][i], m[j][i] + m[i][j], m[k][i] + m[i][k]
    return _normalized(q)


def _normalized(q: list[float]) -> list[float]:
    norm = math.sqrt(q[0] * q[0] + q[1] * q[1] + q[2] * q[2] + q[3] * q[3])
    return [c / norm for c in q]


def _product(p: list[float], q: list[float]) -> list[float]:
    """Returns the quaternion of rotation q followed by rotation p."""
    return _normalized([
        p[3] * q[0] + q[3] * p[0] + (p[1] * q[2] - p[2] * q[1]),
        p[3] * q[1] + q[3] * p[1] + (p[2] * q[0] - p[0] * q[2]),
        p[3] * q[2] + q[3] * p[2] + (p[0] * q[1] - p[1] * q[0]),
        p[3] * q[3] - p[0] * q[0] - p[1] * q[1] - p[2] * q[2]])


def _rotation_vector(q: list[float]) -> list[float]:
    """Returns axis times angle, at most half a turn, of a quaternion of norm 1."""
    x, y, z, w = q if q[3] >= 0 else [-c for c in q]
    angle = 2 * math.atan2(math.sqrt(x * x + y * y + z * z), w)
    square = angle * angle
    scale = 2 + square / 12 + 7 * square * square / 2880 if angle <= _SMALL_ANGLE \
        else angle / math.sin(angle / 2)
    return [scale * x, scale * y, scale * z]


def _from_rotation_vector(vector: list[float]) -> list[float]:
    """Returns the quaternion of axis times angle."""
    x, y, z = vector
    angle = math.sqrt(x * x + y * y + z * z)
    square = angle * angle
    scale = 0.5 - square / 48 + square * square / 3840 if angle <= _SMALL_ANGLE \
        else math.sin(angle / 2) / angle
    return [scale * x, scale * y, scale * z, math.cos(angle / 2)]
