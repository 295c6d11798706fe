# SPDX-License-Identifier: Apache-2.0
"""Lines that show where things are: container, region of interest, cameras."""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.types import Container, Intrinsics

_WALL_LINES = 12
_BOX_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]


def container_lines(container: Container) -> np.ndarray:
    """Returns lines along floor, rim and inner wall of a container.

    Returns:
        (n, 2, 3) ends, world, metres; n = 0 where there is no wall.
    """
    if container.rings is None:
        return np.zeros((0, 2, 3))
    rings = container.rings[container.rings[:, 0, 2] >= container.floor_thickness_m]
    lines = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings[[0, -1]]]
    walls = rings[:, ::max(rings.shape[1] // _WALL_LINES, 1)]  # (k, w, 3)
    lines.append(np.stack([walls[:-1], walls[1:]], axis=2).reshape(-1, 2, 3))
    return geometry.apply(container.T_world_container, np.concatenate(lines))


def box_lines(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """Returns the edges of an upright box between two (3,) corners: (12, 2, 3) ends."""
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)]
                        for i in range(8)])
    return corners[np.array(_BOX_EDGES)]


def frustum_lines(intrinsics: Intrinsics, T_world_camera: np.ndarray, depth: float) -> np.ndarray:
    """Returns lines from a camera to the corners of its image, and around the image.

    Args:
        intrinsics: calibration of the camera.
        T_world_camera: (4, 4) pose of its optical frame.
        depth: distance of the drawn image along the optical axis, metres.

    Returns:
        (8, 2, 3) ends, world, metres.
    """
    k = intrinsics
    low, right, bottom = -0.5, k.width - 0.5, k.height - 0.5  # pixel centres: whole numbers
    pixels = np.array([[low, low], [right, low], [right, bottom], [low, bottom]])
    corners = np.column_stack([(pixels - [k.cx, k.cy]) / [k.fx, k.fy], np.ones(4)]) * depth
    rays = np.stack([np.zeros((4, 3)), corners], axis=1)
    around = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return geometry.apply(T_world_camera, np.concatenate([rays, around]))
