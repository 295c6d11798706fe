# SPDX-License-Identifier: Apache-2.0
"""A container's inner surface: what an empty one shows from above, and what lies inside it."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import Container, HeightMap, Mesh

_ANGLES = 721  # of the table of radii


def opening_map(container: Container, pitch: float) -> tuple[HeightMap, float]:
    """Inner surface over the rim opening, and the opening's area in m2.

    Args:
        container: with rings.
        pitch: side of a cell, metres.

    Returns:
        Heights of wall or floor above the support plane; NaN outside the opening.
    """
    assert container.rings is not None  # for the type checker
    rim = container.rings[-1, :, :2]
    low, high = rim.min(axis=0), rim.max(axis=0)
    cols, rows = (max(int(round(n)), 1) for n in (high - low) / pitch)
    corner = (low + high - np.array([cols, rows]) * pitch) / 2
    T_world_map = container.T_world_container @ geometry.pose(np.eye(3), np.append(corner, 0))
    grid = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1)
    inside = inside_outline(rim, corner + (grid + 0.5) * pitch)
    wall = FusedSurface(wall_mesh(container)).heights(T_world_map, pitch, (rows, cols)).heights
    floor = np.float32(container.floor_thickness_m)
    inner = np.where(inside, np.fmax(wall, floor), np.float32(np.nan))
    return HeightMap(T_world_map, pitch, inner.astype(np.float32)), outline_area(rim)


def wall_mesh(container: Container) -> Mesh:
    """Inner wall from the support plane to the rim, world frame, seen from inside."""
    assert container.rings is not None  # for the type checker
    k, n = container.rings.shape[:2]
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    quads = [np.concatenate([np.stack([a, b + n, b], 1), np.stack([a, a + n, b + n], 1)]) + i * n
             for i in range(k - 1)]
    vertices = geometry.apply(container.T_world_container, container.rings.reshape(-1, 3))
    return Mesh(vertices.astype(np.float32), np.concatenate(quads).astype(np.int32))


class WallTable:
    """How far points lie inside a container's inner wall, by a table of its radii."""

    def __init__(self, container: Container):
        """`container`: with rings."""
        assert container.rings is not None  # for the type checker
        self._levels = container.rings[:, 0, 2]
        angles = np.linspace(-np.pi, np.pi, _ANGLES)
        self._radii = np.stack([_radius(ring[:, :2], angles) for ring in container.rings])

    def inside(self, points: np.ndarray) -> np.ndarray:
        """(n,) metres that points (n, 3) of the container's frame lie inside the inner wall at
        their own height (above the rim: its outline), along the radius; negative outside."""
        x, y, z = points.T
        level = np.interp(z, self._levels, np.arange(len(self._levels)))
        angle = (np.arctan2(y, x) + np.pi) / (2 * np.pi) * (_ANGLES - 1)
        return ndimage.map_coordinates(self._radii, [level, angle], order=1) - np.hypot(x, y)


def _radius(ring: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(n,) distance from the middle to a closed star-shaped outline at given angles."""
    a, b = ring, np.roll(ring, -1, axis=0)
    starts = np.arctan2(a[:, 1], a[:, 0])
    order = np.argsort(starts)
    side = order[(np.searchsorted(starts[order], angle, side="right") - 1) % len(ring)]
    along = b[side] - a[side]
    across = np.cos(angle) * along[:, 1] - np.sin(angle) * along[:, 0]
    return (a[side, 0] * along[:, 1] - a[side, 1] * along[:, 0]) / across


def inside_outline(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(...) bool: the points (..., 2) lie inside a closed outline (n, 2)."""
    x, y = points[..., 0], points[..., 1]
    inside = np.zeros(x.shape, bool)
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0)):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return inside


def outline_area(outline: np.ndarray) -> float:
    """m2 inside a closed counter-clockwise outline (n, 2), metres."""
    (x, y), (u, w) = outline.T, np.roll(outline, -1, axis=0).T
    return float(np.sum(x * w - u * y)) / 2
