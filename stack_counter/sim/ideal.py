# SPDX-License-Identifier: Apache-2.0
"""The surface of a scene as an ideal view from straight above sees it, by casting rays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.scenes.scene import Scene

_LOWEST_STACK = 0.05  # part lengths above the support plane from which a heap's cells are its own


@dataclass(frozen=True, eq=False)
class IdealSurface:
    """Exact heights of a scene at the network's resolution, above the support plane.

    Attributes:
        top: (rows, cols) float32 height of the highest surface, part lengths.
        inner: (rows, cols) float32 height of the container's inner surface, part lengths.
        valid: (rows, cols) bool: over the container's opening; of a heap, over the stack.
    """

    top: np.ndarray
    inner: np.ndarray
    valid: np.ndarray


@dataclass(frozen=True, eq=False)
class SurfaceGrid:
    """Cells over a container's opening, or around a heap, along the container's axes.

    Attributes:
        corner: (2,) float64 lowest x and y, container frame, metres.
        shape: rows (along y) and columns (along x).
        pitch: side of a cell, metres.
    """

    corner: np.ndarray
    shape: tuple[int, int]
    pitch: float

    def T_world_map(self, T_world_container: np.ndarray) -> np.ndarray:
        """(4, 4) frame of the cells, as `HeightMap` has it."""
        T_container_map = np.eye(4)
        T_container_map[:2, 3] = self.corner
        return T_world_container @ T_container_map

    def world_xy(self, T_world_container: np.ndarray, cells: np.ndarray) -> np.ndarray:
        """(..., 2) world x and y, metres, of the middles of cells, (..., 2) rows and columns."""
        local = np.zeros((*cells.shape[:-1], 3))
        local[..., :2] = (cells[..., ::-1] + 0.5) * self.pitch
        return geometry.apply(self.T_world_map(T_world_container), local)[..., :2]

    def all_world_xy(self, T_world_container: np.ndarray) -> np.ndarray:
        """(rows, cols, 2) world x and y of all cells' middles, metres."""
        return self.world_xy(T_world_container, np.moveaxis(np.indices(self.shape), 0, -1))


def ideal_surface(scene: Scene) -> IdealSurface:
    """Casts rays straight down on the parts and on the container's inner surface."""
    part_length, container = scene.truth.unit_volume ** (1 / 3), scene.container
    parts = scene.parts_mesh()
    xy = surface_grid(scene).all_world_xy(container.T_world_container)
    top, inside = RayCaster(parts).surface_heights(xy), container.inner_mesh()
    if inside is None:  # A heap: the inner surface is the support plane.
        top = np.maximum(top, 0) / part_length
        stack = ndimage.binary_fill_holes(top > _LOWEST_STACK)
        return IdealSurface(top.astype(np.float32), np.zeros_like(top, np.float32), stack)
    inner = RayCaster(inside).surface_heights(xy)
    valid = np.isfinite(inner)
    inner = np.where(valid, inner, 0)
    top = np.where(valid, np.maximum(top, inner), 0)
    return IdealSurface((top / part_length).astype(np.float32),
                        (inner / part_length).astype(np.float32), valid)


def surface_grid(scene: Scene) -> SurfaceGrid:
    """Lays cells over a scene, `PIXELS_PER_LENGTH` a part length."""
    part_length = scene.truth.unit_volume ** (1 / 3)
    if scene.container.kind == "none":
        T_container_world = geometry.inverse(scene.container.T_world_container)
        points = scene.parts_mesh().vertices.astype(float)
        local = geometry.apply(T_container_world, points)[:, :2]
        low, high = local.min(axis=0) - part_length / 2, local.max(axis=0) + part_length / 2
    else:
        low, high = scene.container.opening.min(axis=0), scene.container.opening.max(axis=0)
    pitch = part_length / PIXELS_PER_LENGTH
    cols, rows = np.maximum(np.round((high - low) / pitch).astype(int), 1)
    corner = (low + high) / 2 - np.array([cols, rows]) / 2 * pitch
    return SurfaceGrid(corner, (int(rows), int(cols)), pitch)
