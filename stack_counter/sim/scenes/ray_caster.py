# SPDX-License-Identifier: Apache-2.0
"""Rays straight down on a mesh, and points inside it, by Open3D."""

from __future__ import annotations

import numpy as np

from stack_counter.lean_open3d import o3c, o3d
from stack_counter.types import Mesh

_START_ABOVE_M = 1.0  # height of the rays' origins over the highest vertex


class RayCaster:
    """A mesh that rays are cast on."""

    def __init__(self, mesh: Mesh):
        """Builds the mesh's ray-casting structure."""
        self._scene = o3d.t.geometry.RaycastingScene()
        self._origin_z = float(mesh.vertices[:, 2].max(initial=0.0)) + _START_ABOVE_M
        self._empty = len(mesh.triangles) == 0
        if not self._empty:
            self._scene.add_triangles(o3c.Tensor(mesh.vertices),
                                      o3c.Tensor(mesh.triangles.astype(np.uint32)))

    def surface_heights(self, xy: np.ndarray) -> np.ndarray:
        """(...) float64 z of the highest surface at points (..., 2); -inf where there is none."""
        if self._empty:
            return np.full(xy.shape[:-1], -np.inf)
        return self._origin_z - self._cast_down(xy)["t_hit"].numpy().astype(float)

    def hit_triangles(self, xy: np.ndarray) -> np.ndarray:
        """(...) int64 number of the highest triangle at points (..., 2); -1 where there is none.

        The points are x and y, metres.
        """
        if self._empty:
            return np.full(xy.shape[:-1], -1)
        hits = self._cast_down(xy)
        return np.where(np.isfinite(hits["t_hit"].numpy()),
                        hits["primitive_ids"].numpy().astype(np.int64), -1)

    def _cast_down(self, xy: np.ndarray) -> dict[str, o3c.Tensor]:
        rays = np.zeros((*xy.shape[:-1], 6), np.float32)
        rays[..., :2], rays[..., 2], rays[..., 5] = xy, self._origin_z, -1
        hits: dict[str, o3c.Tensor] = self._scene.cast_rays(o3c.Tensor(rays))
        return hits

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(...) bool: the points (..., 3) lie inside the mesh, which is closed."""
        return self._scene.compute_occupancy(o3c.Tensor(points.astype(np.float32))).numpy() > 0.5
