# SPDX-License-Identifier: Apache-2.0
"""Depth views of one scan become one surface inside a region that grows with what they show."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.fusion.depth_filter import open_background, smooth_depth
from stack_counter.fusion.leveling import level_to_support
from stack_counter.fusion.region import Region, crop_to_region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.tsdf import Tsdf, automatic_voxel_size
from stack_counter.types import View


@dataclass(frozen=True)
class DepthFusionSettings:
    """How the fusion decides what is surface and what has changed.

    Attributes:
        min_views: views that must have seen a voxel for its surface to count; chosen.
        change_noise: standard deviations of the depth's noise beyond which a pixel shows that
            something was added or taken away; measured by `stack-counter evaluate live`.
    """

    min_views: int = 1
    change_noise: float = 3.0


SETTINGS = DepthFusionSettings()


class DepthFusion:
    """Crops, levels, smooths and integrates views; in live mode it forgets what has changed.

    Attributes:
        region: where the stack is, as far as the views so far show.
        voxel_size: side of a voxel, metres.
    """

    def __init__(self, region: Region, config: ReconstructorConfig, unit_volume: float):
        """Chooses the voxel size and makes an empty TSDF.

        Args:
            region: as found in the first views.
            config: voxel, truncation and memory settings.
            unit_volume: volume of one part, m3; 0 where it is not known.
        """
        self.region = region
        self.voxel_size = config.voxel_size or automatic_voxel_size(region, unit_volume)
        self._live, self._depth_trunc = config.live, config.depth_trunc
        self._tsdf = Tsdf(self.voxel_size, config.trunc_voxels, config.depth_trunc,
                          config.max_weight, config.max_memory_mb)
        self._last_surface: FusedSurface | None = None

    def grow_region(self, view: View) -> None:
        """Takes in what the view shows standing across the region's border."""
        self.region = self.region.grown_by(view)

    def integrate(self, view: View, is_smooth: bool = False) -> View:
        """Fuses one view.

        Args:
            view: with depth.
            is_smooth: its depth has been smoothed, as in a view that was returned here.

        Returns:
            The view cropped to the region, levelled and smoothed.

        Raises:
            ViewError: the view shows nothing of the region, or needs more memory than allowed.
        """
        # Crop to the region; level by the support plane, which may show beyond it; smooth.
        if self.region.configured:
            view = crop_to_region(level_to_support(view, self.region), self.region)
        else:
            view = level_to_support(crop_to_region(view, self.region), self.region)
        if not is_smooth:
            view = replace(view, depth=smooth_depth(np.asarray(view.depth), self.region.noise))
        # Only surfaces inside the region are kept; every ray carves.
        is_surface = self.region.contains(geometry.world_points(view))
        depth = open_background(view, self._depth_trunc)
        if self._live and self._last_surface is not None:
            self._tsdf.clear_rays(self._changed_pixels(view, self._last_surface), depth,
                                  view.intrinsics, view.T_world_camera)
        self._tsdf.integrate(depth, is_surface, view.intrinsics, view.T_world_camera)
        return view

    def surface(self) -> FusedSurface:
        """Extracts the surface that the views so far show; it may be empty."""
        self._last_surface = FusedSurface(self._tsdf.extract_triangle_mesh(SETTINGS.min_views))
        return self._last_surface

    def _changed_pixels(self, view: View, surface: FusedSurface) -> np.ndarray:
        """Finds the pixels whose depth is not that of a surface, noise apart: (h, w) bool."""
        depth = np.asarray(view.depth)
        expected = surface.depth(view.intrinsics, view.T_world_camera)
        differs = np.abs(depth - expected) > SETTINGS.change_noise * self.region.noise
        changed = differs & (depth > 0) & (expected > 0)
        # A lone pixel beside an edge has not changed: its ray ends now on one side, now beyond.
        return cv2.morphologyEx(changed.astype(np.uint8), cv2.MORPH_OPEN,
                                np.ones((3, 3), np.uint8)) > 0
