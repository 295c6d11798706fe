# SPDX-License-Identifier: Apache-2.0
"""The fused surface as an ideal sensor sees it: heights from straight above, depth from a camera.

Source: Open3D's `RaycastingScene` (Embree).
"""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.lean_open3d import o3c, o3d
from stack_counter.types import HeightMap, Intrinsics, Mesh


class FusedSurface:
    """Casts rays at a mesh, straight down or as a camera sees it.

    Attributes:
        mesh: as given, world frame.
    """

    def __init__(self, mesh: Mesh):
        """Prepares the mesh, world frame, for ray casting; it may be empty."""
        self.mesh = mesh
        self._scene = o3d.t.geometry.RaycastingScene()
        self._empty = len(mesh.triangles) == 0
        if not self._empty:
            self._scene.add_triangles(o3c.Tensor(mesh.vertices),
                                      o3c.Tensor(mesh.triangles.astype(np.uint32)))
            self._above = float(mesh.vertices[:, 2].max()) + 1.0

    def heights(self, T_world_map: np.ndarray, pitch: float, shape: tuple[int, int]) -> HeightMap:
        """Highest surface at the centre of every cell of a map; NaN where there is none.

        Args:
            T_world_map: (4, 4) map frame, z up in the world.
            pitch: side of a cell, metres.
            shape: (rows, cols).
        """
        heights = np.full(shape, np.nan, np.float32)
        if self._empty:
            return HeightMap(T_world_map, pitch, heights)
        # One ray straight down through the middle of each cell.
        rows, cols = np.mgrid[:shape[0], :shape[1]]
        centers = np.stack([(cols + 0.5) * pitch, (rows + 0.5) * pitch, np.zeros(shape)], axis=-1)
        origins = geometry.apply(T_world_map, centers)
        origins[..., 2] = self._above
        hits = self._cast_rays(origins, np.array([0.0, 0, -1]))
        z = self._above - hits - T_world_map[2, 3]
        heights[np.isfinite(hits)] = z[np.isfinite(hits)]
        return HeightMap(T_world_map, pitch, heights)

    def depth(self, intrinsics: Intrinsics, T_world_camera: np.ndarray) -> np.ndarray:
        """Depth image of the mesh.

        Args:
            intrinsics: pinhole calibration of the camera.
            T_world_camera: (4, 4) pose of its optical frame.

        Returns:
            (h, w) float32, metres along the optical axis; 0 where the camera sees no mesh.
        """
        if self._empty:
            return np.zeros((intrinsics.height, intrinsics.width), np.float32)
        rays = geometry.pixel_rays(intrinsics, dtype=np.float64) @ T_world_camera[:3, :3].T
        hits = self._cast_rays(T_world_camera[:3, 3], rays)  # each ray is 1 m long along the axis
        return np.where(np.isfinite(hits), hits, 0).astype(np.float32)

    def _cast_rays(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """(h, w) float32 lengths of world rays up to the mesh, infinite where they miss it.

        The lengths are multiples of the directions' own. One argument may be a (3,) vector.
        """
        shape = np.broadcast_shapes(origins.shape, directions.shape)
        rays = np.concatenate([np.broadcast_to(origins, shape),
                               np.broadcast_to(directions, shape)], axis=-1)
        return self._scene.cast_rays(o3c.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
