# SPDX-License-Identifier: Apache-2.0
"""A container's inner surface: what an empty one shows from above, and what lies inside it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.container.inner_map import sample_heights
from stack_counter.fusion.surface import FusedSurface
from stack_counter.types import Container, HeightMap, Mesh


@dataclass(frozen=True)
class InnerSurfaceSettings:
    """How finely a wall is tabulated.

    Attributes:
        angle_samples: directions of the table of radii, the first one twice; chosen, two for
            each degree.
    """

    angle_samples: int = 721


SETTINGS = InnerSurfaceSettings()


@dataclass(frozen=True, eq=False)
class RimOpening:
    """What the rim of a container encloses.

    Attributes:
        inner: heights of wall or floor above the support plane; NaN outside the opening.
        area: within the rim's inner outline, m2.
    """

    inner: HeightMap
    area: float


def map_rim_opening(container: Container, pitch: float) -> RimOpening:
    """Maps the inner surface over the rim opening.

    Args:
        container: with rings.
        pitch: side of a cell, metres.
    """
    # A map around the rim's inner outline, centred on it.
    rim = _rings(container)[-1, :, :2]
    low, high = rim.min(axis=0), rim.max(axis=0)
    cols, rows = (max(int(round(n)), 1) for n in (high - low) / pitch)
    corner = (low + high - np.array([cols, rows]) * pitch) / 2
    T_world_map = container.T_world_container @ geometry.pose(np.eye(3), np.append(corner, 0))
    # Cells whose middle lies inside that outline.
    grid = np.stack(np.meshgrid(np.arange(cols), np.arange(rows)), axis=-1)
    inside = inside_outline(rim, corner + (grid + 0.5) * pitch)
    # The wall as seen from above; the floor where the wall is lower or not there.
    if container.inner_map is not None:
        wall = sample_heights(container.inner_map, corner + (grid + 0.5) * pitch)
    else:
        wall = FusedSurface(wall_mesh(container)).heights(T_world_map, pitch, (rows, cols)).heights
    floor = np.float32(container.floor_thickness_m)
    heights = np.where(inside, np.fmax(wall, floor), np.float32(np.nan))
    return RimOpening(HeightMap(T_world_map, pitch, heights.astype(np.float32)),
                      outline_area(rim))


def wall_mesh(container: Container) -> Mesh:
    """Inner wall from the support plane to the rim, world frame, seen from inside.

    Args:
        container: with rings.
    """
    rings = _rings(container)
    k, n = rings.shape[:2]
    # Two triangles for each side of each ring, up to the next ring.
    a, b = np.arange(n), np.roll(np.arange(n), -1)
    quads = [np.concatenate([np.stack([a, b + n, b], 1), np.stack([a, a + n, b + n], 1)]) + i * n
             for i in range(k - 1)]
    vertices = geometry.apply(container.T_world_container, rings.reshape(-1, 3))
    return Mesh(vertices.astype(np.float32), np.concatenate(quads).astype(np.int32))


class WallTable:
    """Looks up how far points lie inside a container's inner wall, in a table of its radii."""

    def __init__(self, container: Container):
        """Tabulates the radii of each ring.

        Args:
            container: with rings.
        """
        rings = _rings(container)
        self._levels = rings[:, 0, 2]
        angles = np.linspace(-np.pi, np.pi, SETTINGS.angle_samples)
        self._radii = np.stack([_radii_at(ring[:, :2], angles) for ring in rings])

    def depth_inside(self, points: np.ndarray) -> np.ndarray:
        """Distances of points from the inner wall, along the radius.

        Args:
            points: (n, 3) metres, container frame.

        Returns:
            (n,) metres inwards from the wall at a point's own height, above the rim from its
            outline; negative outside.
        """
        x, y, z = points.T
        level = np.interp(z, self._levels, np.arange(len(self._levels)))
        angle = (np.arctan2(y, x) + np.pi) / (2 * np.pi) * (SETTINGS.angle_samples - 1)
        return ndimage.map_coordinates(self._radii, [level, angle], order=1) - np.hypot(x, y)


def inside_outline(outline: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(...) bool: the points (..., 2) lie inside a closed outline (n, 2).

    Source: crossing number of a ray along x (Shimrat, 1962).
    """
    x, y = points[..., 0], points[..., 1]
    inside = np.zeros(x.shape, bool)
    for (ax, ay), (bx, by) in zip(outline, np.roll(outline, -1, axis=0)):
        if ay != by:
            inside ^= ((ay > y) != (by > y)) & (x < ax + (y - ay) / (by - ay) * (bx - ax))
    return inside


def outline_area(outline: np.ndarray) -> float:
    """Area inside a closed counter-clockwise outline (n, 2) in metres, m2 (shoelace formula)."""
    (x, y), (u, w) = outline.T, np.roll(outline, -1, axis=0).T
    return float(np.sum(x * w - u * y)) / 2


def _rings(container: Container) -> np.ndarray:
    """(k, n, 3) outlines of a container's inner wall."""
    if container.rings is None:
        raise ValueError(f"a container of kind '{container.kind}' without rings; expected one "
                         "that was fitted, configured or taught")
    return container.rings


def _radii_at(ring: np.ndarray, angle: np.ndarray) -> np.ndarray:
    """(n,) distances from the middle to a star-shaped outline (k, 2) at angles (n,), rad."""
    # The side of the outline that each angle meets.
    a, b = ring, np.roll(ring, -1, axis=0)
    starts = np.arctan2(a[:, 1], a[:, 0])
    order = np.argsort(starts)
    side = order[(np.searchsorted(starts[order], angle, side="right") - 1) % len(ring)]
    # Where the ray meets that side.
    along = b[side] - a[side]
    across = np.cos(angle) * along[:, 1] - np.sin(angle) * along[:, 0]
    return (a[side, 0] * along[:, 1] - a[side, 1] * along[:, 0]) / across
