"""TSDF fusion and carving of depth views; the only module that touches Open3D.

Source: paper, section 3.3 (fused and carved volume); the update rule is that of Curless and Levoy
(1996) as Open3D's `VoxelBlockGrid.integrate` runs it.
"""

from __future__ import annotations

import numpy as np
import open3d as o3d
import open3d.core as o3c

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.types import HeightMap, Intrinsics, Mesh, View

_CPU = o3c.Device("CPU:0")
_BLOCK = 8  # voxels along a block's side: small blocks follow the surface closely
_BYTES = 8  # of a voxel: distance and weight
_BLOCKS = 20_000  # first size of the hash map; it grows by itself
# Open3D cuts pixel coordinates off instead of rounding them; our pixel centres lie on whole
# numbers. Without this every surface is read half a pixel beside its place.
_TO_CORNER = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


class Tsdf:
    """A sparse truncated signed distance field.

    Every view updates all blocks that exist, not only those on its own surface: what it sees
    through is free, so a ghost surface of an earlier view is carved.
    """

    def __init__(self, voxel_size: float, trunc_voxels: float, depth_trunc: float,
                 max_weight: float, max_memory_mb: float):
        """Lengths in metres; `trunc_voxels` is sdf_trunc in voxels; of a voxel's views at most
        `max_weight` count, so that what is taken away later disappears."""
        self.voxel_size = voxel_size
        self._max_weight = max_weight
        self._max_memory_mb = max_memory_mb
        self._trunc_voxels = trunc_voxels
        self._views = 0
        self._depth_trunc = depth_trunc
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (o3c.float32, o3c.float32), [o3c.SizeVector([1])] * 2,
            voxel_size, _BLOCK, _BLOCKS, _CPU)

    def integrate(self, depth: np.ndarray, surface: np.ndarray, intrinsics: Intrinsics,
                  T_world_camera: np.ndarray) -> None:
        """Fuses one view.

        Args:
            depth: (h, w) float32, metres, 0 invalid; carves along every valid ray.
            surface: (h, w) bool, the pixels whose surface is to be kept (region of interest);
                only these make new blocks.
            intrinsics: pinhole calibration of `depth`.
            T_world_camera: (4, 4) pose of the optical frame.

        Raises:
            ViewError: reason `too_large`: more memory than allowed.
        """
        K = o3c.Tensor(intrinsics.K + _TO_CORNER)
        T_camera_world = o3c.Tensor(geometry.inverse(T_world_camera))
        image = o3d.t.geometry.Image(o3c.Tensor(np.ascontiguousarray(depth, np.float32)))
        wanted = o3d.t.geometry.Image(o3c.Tensor(np.where(surface, depth, 0).astype(np.float32)))
        settings = (1.0, self._depth_trunc, self._trunc_voxels)
        blocks = np.concatenate([self._blocks(),
                                 self._new_blocks(wanted, K, T_camera_world, settings)])
        needed = len(blocks) * _BLOCK**3 * _BYTES / 1e6
        if needed > self._max_memory_mb:
            raise ViewError("too_large", f"the volume needs {needed:.0f} MB at a voxel_size of "
                                         f"{self.voxel_size} m; expected at most "
                                         f"{self._max_memory_mb:.0f} MB (max_memory_mb)")
        if len(blocks):
            self._grid.integrate(o3c.Tensor(blocks), image, K, T_camera_world, *settings)
            self._views += 1
            if self._views > self._max_weight:  # no weight can be above it before
                weights = self._grid.attribute("weight").numpy()  # shares the memory
                np.minimum(weights, self._max_weight, out=weights)

    def forget(self, changed: np.ndarray, depth: np.ndarray, intrinsics: Intrinsics,
               T_world_camera: np.ndarray) -> None:
        """Lets the next view alone say what is along some pixels' rays, up to their surface.

        Args:
            changed: (h, w) bool.
            depth: (h, w) float32, metres, of the surface that is now seen there.
            intrinsics, T_world_camera: as for `integrate`.
        """
        blocks = self._grid.hashmap().active_buf_indices()
        if not len(blocks) or not changed.any():
            return
        points, index = self._grid.voxel_coordinates_and_flattened_indices(blocks)
        seen = geometry.project_into(View(0, intrinsics, T_world_camera), points.numpy(),
                                     np.float32)
        before = depth[seen.rows, seen.cols] - seen.depth
        wiped = changed[seen.rows, seen.cols] & (before > -self._trunc_voxels * self.voxel_size)
        weights = self._grid.attribute("weight").numpy().reshape(-1)  # shares the memory
        weights[index.numpy()[np.flatnonzero(seen.inside)[wiped]]] = 0

    def _new_blocks(self, wanted: o3d.t.geometry.Image, K: o3c.Tensor, T_camera_world: o3c.Tensor,
                    settings: tuple[float, float, float]) -> np.ndarray:
        """(n, 3) int32 coordinates of the blocks on the wanted surface that do not exist yet."""
        try:
            found = self._grid.compute_unique_block_coordinates(wanted, K, T_camera_world,
                                                                *settings)
        except RuntimeError as error:
            if "No block is touched" not in str(error):
                raise
            return np.zeros((0, 3), np.int32)  # the view sees nothing that is to be kept
        # Looked up, not sorted: np.unique over rows takes as long as the fusion itself.
        known = self._grid.hashmap().find(found)[1].numpy()
        return found.numpy()[~known]

    def _blocks(self) -> np.ndarray:
        """(n, 3) int32 coordinates of the blocks that exist."""
        hashmap = self._grid.hashmap()
        return hashmap.key_tensor()[hashmap.active_buf_indices().to(o3c.int64)].numpy()

    def extract_triangle_mesh(self, min_views: int) -> Mesh:
        """The zero level as triangles, where at least `min_views` have seen it."""
        empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
        if not len(self._blocks()):
            return empty
        try:  # Open3D wants a weight above the threshold, and fails where no vertex has one
            mesh = self._grid.extract_triangle_mesh(weight_threshold=min_views - 0.5)
        except RuntimeError:
            return empty
        if "indices" not in mesh.triangle:
            return empty
        return Mesh(mesh.vertex.positions.numpy().astype(np.float32),
                    mesh.triangle.indices.numpy().astype(np.int32))


class FusedSurface:
    """Looks at a mesh, from straight above or as a camera does."""

    def __init__(self, mesh: Mesh):
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
        rows, cols = np.mgrid[:shape[0], :shape[1]]
        cells = np.stack([(cols + 0.5) * pitch, (rows + 0.5) * pitch, np.zeros(shape)], axis=-1)
        origins = geometry.apply(T_world_map, cells)
        origins[..., 2] = self._above
        rays = np.concatenate([origins, np.broadcast_to([0.0, 0, -1], origins.shape)], axis=-1)
        hits = self._scene.cast_rays(o3c.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
        z = self._above - hits - T_world_map[2, 3]
        heights[np.isfinite(hits)] = z[np.isfinite(hits)]
        return HeightMap(T_world_map, pitch, heights)

    def depth(self, intrinsics: Intrinsics, T_world_camera: np.ndarray) -> np.ndarray:
        """(h, w) float32 depth along the optical axis that a camera would measure, metres; 0 where
        it sees nothing of the mesh."""
        if self._empty:
            return np.zeros((intrinsics.height, intrinsics.width), np.float32)
        ways = geometry.pixel_rays(intrinsics, dtype=np.float64) @ T_world_camera[:3, :3].T
        rays = np.concatenate([np.broadcast_to(T_world_camera[:3, 3], ways.shape), ways], axis=-1)
        hits = self._scene.cast_rays(o3c.Tensor(rays.astype(np.float32)))["t_hit"].numpy()
        return np.where(np.isfinite(hits), hits, 0).astype(np.float32)
