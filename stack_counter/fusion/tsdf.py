# SPDX-License-Identifier: Apache-2.0
"""TSDF fusion and carving of depth views.

Source: paper, section 3.3 (fused and carved volume); the update rule is that of Curless and Levoy
(1996) as Open3D's `VoxelBlockGrid.integrate` runs it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.fusion.region import Region
from stack_counter.lean_open3d import o3c, o3d
from stack_counter.types import Intrinsics, Mesh, View


@dataclass(frozen=True)
class TsdfSettings:
    """Sizes of the voxel grid; all values are chosen.

    Attributes:
        coarsest_voxel: side of a voxel for parts and containers of any size, m; the size that the
            error model of V was fitted for.
        finest_voxel: least side of a voxel, m.
        voxels_along_region: number of voxels along a region's longer side above which they
            become larger than that.
        voxels_per_part: number of voxels along the cube root of a part's volume.
        block: voxels along the side of a block; small blocks follow the surface closely.
        first_blocks: first capacity of the hash map of blocks, which takes 4 kB for each and
            grows by itself.
    """

    coarsest_voxel: float = 0.002
    finest_voxel: float = 0.001
    voxels_along_region: int = 400
    voxels_per_part: int = 4
    block: int = 8
    first_blocks: int = 2_000


SETTINGS = TsdfSettings()
_CPU = o3c.Device("CPU:0")
_BYTES_PER_VOXEL = 8  # two float32: distance and weight
# Open3D cuts pixel coordinates off instead of rounding them; our pixel centres lie on whole
# numbers. Without this every surface is read half a pixel beside its place.
_TO_CORNER = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])


def automatic_voxel_size(region: Region, unit_volume: float) -> float:
    """Side of a voxel, m, where no setting gives it.

    Args:
        region: the larger it is, the larger the voxels.
        unit_volume: of a part, m3, or 0 where it is not known; parts that are only a few voxels
            wide get smaller ones.
    """
    extent = float((region.high - region.low)[:2].max())
    size = max(SETTINGS.coarsest_voxel, extent / SETTINGS.voxels_along_region)
    return min(size, voxel_size_for(unit_volume)) if unit_volume else size


def voxel_size_for(unit_volume: float) -> float:
    """Side of a voxel, m, for parts of `unit_volume` (m3) in a region of usual size."""
    part_length = unit_volume ** (1 / 3)
    return min(SETTINGS.coarsest_voxel,
               max(part_length / SETTINGS.voxels_per_part, SETTINGS.finest_voxel))


class Tsdf:
    """A sparse truncated signed distance field.

    Every view updates all blocks that exist, not only those on its own surface: what it sees
    through is free, so a ghost surface of an earlier view is carved.
    """

    def __init__(self, voxel_size: float, trunc_voxels: float, depth_trunc: float,
                 max_weight: float, max_memory_mb: float):
        """Makes an empty field.

        Args:
            voxel_size: side of a voxel, metres.
            trunc_voxels: sdf_trunc, in voxels.
            depth_trunc: farthest depth that is used, metres.
            max_weight: largest number of views that a voxel's distance is the mean of, so that
                what is taken away later disappears.
            max_memory_mb: most memory that the field may take, MB.
        """
        self.voxel_size = voxel_size
        self._max_weight = max_weight
        self._max_memory_mb = max_memory_mb
        self._trunc_voxels = trunc_voxels
        self._views = 0
        self._depth_trunc = depth_trunc
        self._grid = o3d.t.geometry.VoxelBlockGrid(
            ("tsdf", "weight"), (o3c.float32, o3c.float32), [o3c.SizeVector([1])] * 2,
            voxel_size, SETTINGS.block, SETTINGS.first_blocks, _CPU)

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
        # Images and pose as Open3D's tensors.
        K = o3c.Tensor(intrinsics.K + _TO_CORNER)
        T_camera_world = o3c.Tensor(geometry.inverse(T_world_camera))
        image = o3d.t.geometry.Image(o3c.Tensor(np.ascontiguousarray(depth, np.float32)))
        kept = o3d.t.geometry.Image(o3c.Tensor(np.where(surface, depth, 0).astype(np.float32)))
        scales = (1.0, self._depth_trunc, self._trunc_voxels)
        # Blocks that exist, and those to be made on the kept surface, if memory allows.
        blocks = np.concatenate([self._active_blocks(), self._new_blocks(kept, K, T_camera_world,
                                                                  scales)])
        needed_mb = len(blocks) * SETTINGS.block**3 * _BYTES_PER_VOXEL / 1e6
        if needed_mb > self._max_memory_mb:
            raise ViewError("too_large", f"the volume needs {needed_mb:.0f} MB at a voxel_size of "
                                         f"{self.voxel_size} m; expected at most "
                                         f"{self._max_memory_mb:.0f} MB (max_memory_mb)")
        # Update distance and weight of all their voxels; clip the weights.
        if len(blocks):
            self._grid.integrate(o3c.Tensor(blocks), image, K, T_camera_world, *scales)
            self._views += 1
            if self._views > self._max_weight:  # no weight can be above it before
                weights = self._grid.attribute("weight").numpy()  # shares the memory
                np.minimum(weights, self._max_weight, out=weights)

    def clear_rays(self, changed: np.ndarray, depth: np.ndarray, intrinsics: Intrinsics,
                   T_world_camera: np.ndarray) -> None:
        """Clears what was fused along some pixels' rays, up to the surface that they show now.

        The next view alone decides what is there.

        Args:
            changed: (h, w) bool, the pixels whose rays are cleared.
            depth: (h, w) float32, metres, of the surface that is now seen there.
            intrinsics: pinhole calibration of `depth`.
            T_world_camera: (4, 4) pose of the optical frame.
        """
        blocks = self._grid.hashmap().active_buf_indices()
        if not len(blocks) or not changed.any():
            return
        # Project all voxels into the image.
        points, index = self._grid.voxel_coordinates_and_flattened_indices(blocks)
        pixels = geometry.project_into(View(0, intrinsics, T_world_camera), points.numpy(),
                                       np.float32)
        # Clear those in front of the surface, or at most the truncation behind it.
        before = depth[pixels.rows, pixels.cols] - pixels.depth
        cleared = changed[pixels.rows, pixels.cols] \
            & (before > -self._trunc_voxels * self.voxel_size)
        weights = self._grid.attribute("weight").numpy().reshape(-1)  # shares the memory
        weights[index.numpy()[np.flatnonzero(pixels.inside)[cleared]]] = 0

    def extract_triangle_mesh(self, min_views: int) -> Mesh:
        """Extracts the zero level as triangles, where at least `min_views` have seen it."""
        empty = Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
        if not len(self._active_blocks()):
            return empty
        try:  # Open3D wants a weight above the threshold, and fails where no vertex has one
            mesh = self._grid.extract_triangle_mesh(weight_threshold=min_views - 0.5)
        except RuntimeError:
            return empty
        if "indices" not in mesh.triangle:
            return empty
        return Mesh(mesh.vertex.positions.numpy().astype(np.float32),
                    mesh.triangle.indices.numpy().astype(np.int32))

    def _new_blocks(self, kept: o3d.t.geometry.Image, K: o3c.Tensor, T_camera_world: o3c.Tensor,
                    scales: tuple[float, float, float]) -> np.ndarray:
        """(n, 3) int32 coordinates of the blocks on the kept surface that do not exist yet."""
        try:
            found = self._grid.compute_unique_block_coordinates(kept, K, T_camera_world, *scales)
        except RuntimeError as error:
            if "No block is touched" not in str(error):
                raise
            return np.zeros((0, 3), np.int32)  # the view sees nothing that is to be kept
        # Looked up, not sorted: np.unique over rows takes as long as the fusion itself.
        exists = self._grid.hashmap().find(found)[1].numpy()
        return found.numpy()[~exists]

    def _active_blocks(self) -> np.ndarray:
        """(n, 3) int32 coordinates of the blocks that exist."""
        hashmap = self._grid.hashmap()
        return hashmap.key_tensor()[hashmap.active_buf_indices().to(o3c.int64)].numpy()
