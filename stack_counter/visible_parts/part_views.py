# SPDX-License-Identifier: Apache-2.0
"""A part's mesh as points of its surface, and the heights that it shows from all around.

A view from a direction serves all turns about it: where it is read, the surface is turned instead.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy import ndimage

from stack_counter.types import Mesh


@dataclass(frozen=True)
class PartViewSettings:
    """How finely a part is looked at; chosen.

    Attributes:
        points: on the surface of a part.
        directions: from which it is looked at, evenly spread: 14 degrees apart.
        cells: along the side of a view.
        close_cells: distance to covered cells within which gaps between points are closed.
        shown_cells: depth below the highest point of a cell down to which points show, cells.
    """

    points: int = 6000
    directions: int = 200
    cells: int = 40
    close_cells: int = 1
    shown_cells: float = 1.5


SETTINGS = PartViewSettings()
_GOLDEN_ANGLE = np.pi * (3 - 5**0.5)


@dataclass(frozen=True, eq=False)
class PartViews:
    """One part as seen from above at orientations of it.

    Attributes:
        center: (3,) float64 middle of the box around it, mesh frame, metres.
        diameter: largest distance between two points of it, metres.
        points: (n, 3) float64 evenly over its surface, about `center`, metres.
        rotations: (k, 3, 3) float64 from its axes to those of each view, z up.
        heights: (k, cells, cells) float32 highest point in each cell of each view, above `center`,
            metres; NaN beside the part, as in the border. Rows are along y, columns along x,
            `center` is in the middle.
        pitch: side of a cell, metres.
    """

    center: np.ndarray
    diameter: float
    points: np.ndarray
    rotations: np.ndarray
    heights: np.ndarray
    pitch: float

    def at_rotations(self, rotations: np.ndarray) -> PartViews:
        """The same part at (m, 3, 3) other rotations."""
        return replace(self, rotations=rotations, heights=np.stack(
            [_highest_points(self.points @ R.T, self.pitch) for R in rotations]))

    def middles(self) -> np.ndarray:
        """(k, 2) float64 mean x and y of the cells that the part covers in each view, metres."""
        covered = np.isfinite(self.heights)
        along = (np.arange(covered.shape[-1]) + 0.5 - covered.shape[-1] / 2) * self.pitch
        return np.stack([(covered.sum(axis=axis) * along).sum(axis=-1) for axis in (1, 2)],
                        axis=1) / covered.sum(axis=(1, 2))[:, None]

    def shown_points(self, view: int, step: int) -> np.ndarray:
        """(m, 3) float64 of each `step`th point those that show in a view, as `points`."""
        points = self.points[::step]
        turned = points @ self.rotations[view].T
        rows, cols = _cells(turned, self.pitch)
        slack = SETTINGS.shown_cells * self.pitch
        return points[turned[:, 2] >= self.heights[view, rows, cols] - slack]


@lru_cache(maxsize=4)
def make_part_views(mesh: Mesh) -> PartViews:
    """Looks at a part from all around; a mesh that was looked at before is remembered."""
    corners = mesh.vertices[np.unique(mesh.triangles)].astype(float)
    center = (corners.min(axis=0) + corners.max(axis=0)) / 2
    directions = _spread_directions(SETTINGS.directions)
    diameter = float(np.ptp((corners - center) @ directions.T, axis=0).max())
    reach = float(np.linalg.norm(corners - center, axis=1).max())
    empty = PartViews(center, diameter, sample_surface(mesh, SETTINGS.points) - center,
                      np.zeros((0, 3, 3)), np.zeros((0, SETTINGS.cells, SETTINGS.cells)),
                      2 * reach / (SETTINGS.cells - 2))
    return empty.at_rotations(np.stack([_rotation_up(direction) for direction in directions]))


def sample_surface(mesh: Mesh, count: int) -> np.ndarray:
    """(count, 3) float64 points over the surface, as many on equal areas, the same every time."""
    a, b, c = np.moveaxis(mesh.vertices[mesh.triangles].astype(float), 1, 0)
    areas = np.cumsum(np.linalg.norm(np.cross(b - a, c - a), axis=1))
    random = np.random.default_rng(0)
    along = (np.arange(count) + random.random(count)) / count * areas[-1]
    chosen = np.minimum(np.searchsorted(areas, along), len(areas) - 1)
    u, v = random.random((2, count, 1))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    return a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]


def _spread_directions(count: int) -> np.ndarray:
    """(count, 3) unit vectors evenly over the sphere: a Fibonacci lattice."""
    z = 1 - (2 * np.arange(count) + 1) / count
    angle, radius = _GOLDEN_ANGLE * np.arange(count), np.sqrt(1 - z * z)
    return np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=1)


def _rotation_up(direction: np.ndarray) -> np.ndarray:
    """(3, 3) rotation that turns a unit vector upwards."""
    across = np.eye(3)[np.argmin(np.abs(direction))]
    x = np.cross(across, direction)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(direction, x), direction])


def _cells(points: np.ndarray, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """(n,) rows and (n,) columns of a view's cells below (n, 3) points in its axes."""
    cols, rows = np.floor(points[:, :2] / pitch + SETTINGS.cells / 2).astype(int).T
    return rows, cols


def _highest_points(points: np.ndarray, pitch: float) -> np.ndarray:
    """(cells, cells) float32 height of the highest of (n, 3) points in each cell, NaN for none."""
    heights: np.ndarray = np.full((SETTINGS.cells,) * 2, -np.inf, np.float32)
    np.maximum.at(heights, _cells(points, pitch), points[:, 2].astype(np.float32))
    # Close the gaps between points.
    covered, window = np.isfinite(heights), 2 * SETTINGS.close_cells + 1
    gaps = ndimage.binary_closing(covered, np.ones((window, window))) & ~covered
    heights[gaps] = ndimage.maximum_filter(heights, window)[gaps]
    heights[~np.isfinite(heights)] = np.nan
    return heights
