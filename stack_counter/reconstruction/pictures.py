# SPDX-License-Identifier: Apache-2.0
"""Scans without depth: label images are carved into a hull, colour pictures give depth by stereo.

Source: paper, section 3.3: the volume is carved by the pictures' masks and by depth.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace

import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.region import Region
from stack_counter.fusion.tsdf import SETTINGS as TSDF_SETTINGS
from stack_counter.multiview.scan import StereoScan, depth_scan
from stack_counter.multiview.visual_hull import carve_visual_hull
from stack_counter.reconstruction.depth import DepthReconstruction
from stack_counter.reconstruction.key_view import find_key_view
from stack_counter.reconstruction.picture_quality import picture_doubts
from stack_counter.reconstruction.view_memory import ViewMemory
from stack_counter.segmentation import Segmenter
from stack_counter.segmentation.labels import GivenLabelSegmenter, require_labels
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import (
    PARTS,
    Container,
    KeyView,
    Mesh,
    Reason,
    StackVolume,
    View,
    ViewTally,
)

_LIVE_VOTES = 2  # views that must call a voxel background for it to go, in live mode


class PictureReconstruction:
    """Keeps the pictures of one scan and measures the stack when asked.

    Attributes:
        refused_late: empty; kept views are never refused later.
        region: None; pictures are not cropped.
        segmenter: passes on the views' own label images.
        stereo: views with stereo depth that the last `measure` rests on; None where the hull is.
    """

    refused_late: tuple[ViewError, ...] = ()
    region: Region | None = None

    def __init__(self, config: ReconstructorConfig, unit_volume: float = 0.0):
        """`unit_volume`: volume of one part, m3; 0 where it is not known."""
        self._config, self._unit_volume = config, unit_volume
        self._memory = ViewMemory(config.live)
        self.stereo: StereoScan | None = None
        self.segmenter: Segmenter = GivenLabelSegmenter()

    @property
    def views(self) -> list[View]:
        """The views kept so far, whole."""
        return self._memory.views

    @property
    def measured_views(self) -> list[View]:
        """The views that are measured: all that are kept."""
        return self.views

    def add_view(self, view: View) -> None:
        """Keeps one view.

        Raises:
            ViewError: reason `unexpected_depth`: it has depth, and those before it have not.
        """
        if view.depth is not None:
            raise ViewError("unexpected_depth", "some views of the scan have depth and some have "
                                                "not; expected alike")
        self._memory.add_view(view)

    def label_views(self, labels: ScanLabels) -> None:
        """Gives the views their label images where prompts make them.

        Raises:
            ScanError: the prompts cannot be carried to all views.
        """
        self._memory.replace_all(labels.label(self.views))

    def measure_volume(self, taught: TaughtContainer | None) -> StackVolume:
        """Measures V by stereo depth where all views have colour, else by the hull of the labels.

        Args:
            taught: a container measured before, of which only the pose is looked for; or None.

        Raises:
            ScanError: no voxel is left after carving.
        """
        self.stereo = None
        if not any(np.any(require_labels(view) == PARTS) for view in self.views):
            return replace(self._measure_hull(), stack_volume=0.0, stack_volume_std=0.0,
                           reasons=(Reason.NOTHING_FOUND,))
        volume = self._measure_stereo_or_hull(taught)
        doubts = picture_doubts(self.views, volume.container.T_world_container[:3, 3],
                                self._unit_volume)
        return replace(volume, reasons=volume.reasons + doubts)

    def key_view(self) -> KeyView | None:
        """Chooses the view that shows the most parts; with depth where stereo measured it."""
        if self.stereo is None:
            return find_key_view(self.views, self.segmenter)
        key_view = find_key_view(self.stereo.views, self.segmenter)
        return key_view and replace(
            key_view, T_world_camera=self.stereo.T_world_upright @ key_view.T_world_camera)

    def _measure_stereo_or_hull(self, taught: TaughtContainer | None) -> StackVolume:
        """Measures V by stereo where it can; arguments and errors as of `measure_volume`."""
        if not self._config.live and all(view.color is not None for view in self.views):
            with suppress(ScanError):  # stereo sees too little: the hull stands
                return self._measure_stereo(taught)
        return self._measure_hull()

    def _measure_stereo(self, taught: TaughtContainer | None) -> StackVolume:
        """Measures V as from a depth camera, or of a closed container by labels and depth.

        Raises:
            ScanError: stereo measures too little, or the scan with its depth gives no volume.
        """
        stereo = depth_scan(self.views, self._config)
        depth = DepthReconstruction(self._config, self._unit_volume, stereo.window_m)
        for view in stereo.views:
            with suppress(ViewError):  # the others go on
                depth.add_view(view)
        if len(depth.views) < self._config.min_views:
            raise ScanError(f"{len(depth.views)} views with stereo depth used; expected at least "
                            f"{self._config.min_views}")
        volume = depth.measure_volume(taught)
        if stereo.is_closed(volume, self._config):
            volume = stereo.carved(volume, self._config.voxel_size or TSDF_SETTINGS.coarsest_voxel)
        self.stereo = stereo
        return stereo.in_world(volume)

    def _measure_hull(self) -> StackVolume:
        """Measures the visual hull of the labels.

        Raises:
            ScanError: no voxel is left.
        """
        config = self._config
        voxel_size = config.voxel_size or TSDF_SETTINGS.coarsest_voxel
        hull = carve_visual_hull(self.views, voxel_size, config.hull_min_share,
                                 votes=_LIVE_VOTES if config.live else 1)
        # An outline's error of one pixel moves the surface by about half a voxel.
        skin = len(hull.surface) * hull.voxel_size**3
        return StackVolume(
            stamp_ns=max(v.stamp_ns for v in self.views), stack_volume=hull.volume,
            stack_volume_std=skin / 2,
            container=Container("hull", geometry.pose(np.eye(3), hull.middle)),
            fill_level=(0.0, 0.0, 0.0), coverage=1.0, top=None, inner=None, key_view=None,
            views=ViewTally(), reasons=(Reason.NO_DEPTH,),
            mesh=Mesh(hull.surface.astype(np.float32), np.zeros((0, 3), np.int32)))
