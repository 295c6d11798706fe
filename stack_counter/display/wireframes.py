"""Lines that show where things are: container, region of interest, cameras."""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.types import Container, Intrinsics

_WALLS = 12  # lines from floor to rim
_EDGES = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]  # of a box


def container_lines(container: Container) -> np.ndarray:
    """(n, 2, 3) ends of lines, world, metres: rim, floor, and lines between them along the inner
    wall; none (n = 0) where there is no wall."""
    if container.rings is None:
        return np.zeros((0, 2, 3))
    rings = container.rings[container.rings[:, 0, 2] >= container.floor_thickness_m]
    lines = [np.stack([ring, np.roll(ring, -1, axis=0)], axis=1) for ring in rings[[0, -1]]]
    walls = rings[:, ::max(rings.shape[1] // _WALLS, 1)]  # (k, w, 3)
    lines.append(np.stack([walls[:-1], walls[1:]], axis=2).reshape(-1, 2, 3))
    return geometry.apply(container.T_world_container, np.concatenate(lines))


def box_lines(low: np.ndarray, high: np.ndarray) -> np.ndarray:
    """(12, 2, 3) ends of the edges of an upright box between two (3,) corners."""
    corners = np.array([[(low, high)[i >> axis & 1][axis] for axis in range(3)]
                        for i in range(8)])
    return corners[np.array(_EDGES)]


def frustum_lines(k: Intrinsics, T_world_camera: np.ndarray, depth: float) -> np.ndarray:
    """(8, 2, 3) ends of lines, world, metres: from the camera to the corners of its image at that
    depth (metres along the optical axis), and around the image."""
    low, right, bottom = -0.5, k.width - 0.5, k.height - 0.5  # pixel centres: whole numbers
    pixels = np.array([[low, low], [right, low], [right, bottom], [low, bottom]])
    corners = np.column_stack([(pixels - [k.cx, k.cy]) / [k.fx, k.fy], np.ones(4)]) * depth
    rays = np.stack([np.zeros((4, 3)), corners], axis=1)
    around = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return geometry.apply(T_world_camera, np.concatenate([rays, around]))
