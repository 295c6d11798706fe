# SPDX-License-Identifier: Apache-2.0
"""Which parts of a pile show from straight above, where, and how much of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import KDTree

from stack_counter.sim.ideal import SurfaceGrid, surface_grid
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.scenes.scene import Scene, rotation_matrices
from stack_counter.types import Mesh


@dataclass(frozen=True, eq=False)
class PartsFromAbove:
    """The parts that show, on the grid of `ideal.ideal_surface`.

    Attributes:
        numbers: (rows, cols) int16, the part that each cell shows, 0 to k - 1; -1 where none is.
        shares: (k,) float32: of the cells that a part would take if nothing lay on it, those that
            show it.
    """

    numbers: np.ndarray
    shares: np.ndarray

    @property
    def centers(self) -> np.ndarray:
        """(k, 2) float64 row and column: mean of the cells that show each part."""
        cells = np.argwhere(self.numbers >= 0)
        part = self.numbers[self.numbers >= 0]
        count = np.maximum(np.bincount(part, minlength=len(self.shares)), 1)
        sums = [np.bincount(part, along, len(self.shares)) for along in cells.T]
        return np.stack(sums, axis=1) / count[:, None]

    @property
    def cell_counts(self) -> np.ndarray:
        """(k,) int64 number of cells that show each part."""
        return np.bincount(self.numbers[self.numbers >= 0], minlength=len(self.shares))


def parts_from_above(scene: Scene) -> PartsFromAbove:
    """Casts rays straight down on the parts and the container."""
    parts, grid = scene.parts_mesh(), surface_grid(scene)
    xy = grid.all_world_xy(scene.container.T_world_container)
    caster, inside = RayCaster(parts), scene.container.inner_mesh()
    shown = caster.hit_triangles(xy)
    shown = np.where(shown >= 0, shown // len(scene.shape.faces), -1)
    if inside is not None:  # beside the opening, or where the container hides them, none show
        inner = RayCaster(inside).surface_heights(xy)
        shown[~np.isfinite(inner) | (caster.surface_heights(xy) < inner)] = -1
    visible, numbers = np.unique(shown[shown >= 0], return_inverse=True)
    renumbered = np.full(shown.shape, -1, np.int16)
    renumbered[shown >= 0] = numbers
    whole = _outline_cells(scene, visible, grid)
    shares = np.bincount(numbers, minlength=len(visible)) / np.maximum(whole, 1)
    return PartsFromAbove(renumbered, np.minimum(shares, 1).astype(np.float32))


def match_parts(found: np.ndarray, true: np.ndarray, reach: float) -> np.ndarray:
    """Gives each found part the nearest true one that is still free, the surest first.

    Args:
        found: (n, 2) places of found parts, those that count most first.
        true: (k, 2) places of true ones, in the same unit.
        reach: largest distance.

    Returns:
        (n,) int64 number of the true part; -1 where none within reach is left.
    """
    matches, free = np.full(len(found), -1), np.ones(len(true), bool)
    if not len(found) or not len(true):
        return matches
    for i, near in enumerate(KDTree(true).query_ball_point(found, reach)):
        left = [j for j in near if free[j]]
        if left:
            best = min(left, key=lambda j: float(np.sum((true[j] - found[i]) ** 2)))
            matches[i], free[best] = best, False
    return matches


def _outline_cells(scene: Scene, parts: np.ndarray, grid: SurfaceGrid) -> np.ndarray:
    """(k,) number of cells that each of (k,) parts takes from above if nothing lies on it."""
    if not len(parts):
        return np.zeros(0, int)
    poses, faces = scene.poses[parts], scene.shape.faces
    points = np.einsum("nij,vj->nvi", rotation_matrices(poses), scene.shape.vertices) \
        + poses[:, None, :3]  # (k, v, 3), container frame
    # Lay the parts side by side, each on as many cells, where it lay between their centres.
    points = np.concatenate([(points[..., :2] - grid.corner) / grid.pitch, points[..., 2:]], -1)
    points[..., :2] -= np.floor(points[..., :2].min(axis=1, keepdims=True))
    side = int(np.ceil(points[..., :2].max()))
    points[..., 0] += side * np.arange(len(parts))[:, None]
    offsets = (np.arange(len(parts)) * len(scene.shape.vertices))[:, None, None]
    mesh = Mesh(points.reshape(-1, 3).astype(np.float32),
                (faces[None] + offsets).reshape(-1, 3).astype(np.int32))
    rows, cols = np.mgrid[:side, :side * len(parts)] + 0.5
    hit = RayCaster(mesh).hit_triangles(np.stack([cols, rows], axis=-1)) >= 0
    return hit.reshape(side, len(parts), side).sum(axis=(0, 2))
