# SPDX-License-Identifier: Apache-2.0
"""Scans with depth: views are fused and carved as they come, V is measured in their surface.

Source: paper, section 3.3.
"""

from __future__ import annotations

import math
from contextlib import suppress
from dataclasses import dataclass, replace

from stack_counter.config import ReconstructorConfig
from stack_counter.container.catalogue import TaughtContainer
from stack_counter.container.detection import FoundContainer, find_container
from stack_counter.container.placement import place_container
from stack_counter.display.mesh_colors import color_mesh
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.depth_filter import clip_depth
from stack_counter.fusion.depth_fusion import DepthFusion
from stack_counter.fusion.pixel_spacing import pixel_spacing
from stack_counter.fusion.region import Region, find_region, seen_from_one_side
from stack_counter.fusion.upright import require_z_up
from stack_counter.reconstruction.alignment import AlignedScan, align_scan
from stack_counter.reconstruction.filling_level import measure_filling_level
from stack_counter.reconstruction.geometry_checks import check_geometry
from stack_counter.reconstruction.integral import MeasuredStack
from stack_counter.reconstruction.key_view import find_key_view
from stack_counter.reconstruction.plausibility import (
    rim_leaves_images,
    stack_leaves_every_image,
    stack_leaves_region,
)
from stack_counter.reconstruction.stack_volume import measure_stack
from stack_counter.reconstruction.surroundings import Surroundings, inspect_surroundings
from stack_counter.reconstruction.view_memory import ViewMemory
from stack_counter.segmentation import Segmenter
from stack_counter.segmentation.from_container import ContainerSegmenter
from stack_counter.segmentation.labels import GivenLabelSegmenter
from stack_counter.segmentation.scan_labels import ScanLabels
from stack_counter.types import KeyView, Reason, StackVolume, View, ViewTally


@dataclass(frozen=True)
class DepthScanSettings:
    """When a scan with depth begins, and from when on its result is flagged.

    Attributes:
        first_views: views from which the region of interest is found; chosen.
        low_coverage: share of the footprint below which a result is flagged; chosen.
    """

    first_views: int = 3
    low_coverage: float = 0.7


SETTINGS = DepthScanSettings()


class DepthReconstruction:
    """Fuses the depth views of one scan and measures the stack in them.

    Attributes:
        segmenter: labels the views; from the first `measure` on by the container found.
        stack: what the last `measure` integrated; None before.
    """

    def __init__(self, config: ReconstructorConfig, unit_volume: float = 0.0,
                 stereo_window_m: float = 0.0):
        """Begins a scan.

        Args:
            config: settings.
            unit_volume: volume of one part, m3; 0 where it is not known.
            stereo_window_m: see `Region`.
        """
        self._config, self._unit_volume = config, unit_volume
        self._stereo_window_m = stereo_window_m
        self._first_views = 1 if config.live else min(SETTINGS.first_views, config.min_views)
        self._memory = ViewMemory(config.live)
        self._fusion: DepthFusion | None = None  # once the first views say where the stack is
        self._surroundings = Surroundings()
        self._label_images_given = False
        self._refused_late: list[ViewError] = []  # once the region was known
        self._left_out: tuple[ViewError, ...] = ()  # by the last measurement
        self._measured_views: list[View] | None = None
        self.segmenter: Segmenter = GivenLabelSegmenter()
        self.stack: MeasuredStack | None = None

    @property
    def views(self) -> list[View]:
        """The views kept so far; once the region is found, cropped to it."""
        return self._memory.views

    @property
    def measured_views(self) -> list[View]:
        """The views that the last `measure_volume` rests on, with the poses that it found."""
        return self.views if self._measured_views is None else self._measured_views

    @property
    def refused_late(self) -> list[ViewError]:
        """Errors of views that were kept at first and refused later, for what others show."""
        return [*self._refused_late, *self._left_out]

    @property
    def region(self) -> Region | None:
        """The region in which the stack lies; None before it is found."""
        return self._fusion.region if self._fusion else None

    def add_view(self, view: View) -> None:
        """Fuses one view, or keeps it until the first few say where the stack is.

        Raises:
            ViewError: the view has no depth (`no_depth`), none in the working range
                (`empty_depth`), shows nothing of the region (`out_of_sight`), or needs too much
                memory (`too_large`).
        """
        if view.depth is None:
            raise ViewError("no_depth", "some views of the scan have depth and some have not; "
                                        "expected alike")
        view = clip_depth(view, self._config.depth_min, self._config.depth_trunc)
        if self._fusion is not None:
            if not self._fusion.region.configured:
                self._fusion.grow_region(view)
            self._memory.add_view(self._fusion.integrate(view))
            return
        self._memory.add_view(view)
        if len(self.views) >= self._first_views:
            with suppress(ScanError):  # nothing in sight yet: later views may show it
                self._fusion = self._begin_fusion()

    def label_views(self, labels: ScanLabels) -> None:
        """Gives the views their label images where prompts make them.

        Raises:
            ScanError: the prompts cannot be carried to all views.
        """
        self._memory.replace_all(labels.label(self.views))
        self._label_images_given = labels.given_with_views

    def measure_volume(self, taught: TaughtContainer | None) -> StackVolume:
        """Finds the container, then V over its opening.

        Args:
            taught: a container measured before, of which only the pose is looked for; or None.

        Raises:
            ScanError: nothing in sight, no support plane, views that contradict each other,
                several containers, or no surface left after carving.
        """
        if self._fusion is None:
            self._fusion = self._begin_fusion()
        config = self._config
        if self._surroundings.refusal:
            raise self._surroundings.refusal
        # Bring the views together, or refuse a scan that cannot be right.
        self._measured_views, self._left_out = None, ()
        scan = align_scan(self._fusion, self.views, config, self._unit_volume)
        region, views, voxel_size = scan.fusion.region, scan.views, scan.fusion.voxel_size
        self._measured_views, self._left_out = views, scan.left_out
        # Extract the fused surface.
        surface = scan.fusion.surface()
        if not len(surface.mesh.triangles):
            raise ScanError(f"no surface left after carving {len(views)} views; expected some: "
                            "depth and poses disagree")
        # Find the container, or the place of a taught one.
        if taught is None:
            found = find_container(surface, views, region, voxel_size, config,
                                   self._unit_volume)
        else:
            found = FoundContainer(place_container(taught, surface, views, region, voxel_size,
                                                   config, self._unit_volume), sure=True)
        rim_says = taught is not None or (config.container_inner_size_m[2] > 0
                                          and config.container_pose == "found")
        if not region.support_certain and not (rim_says and found.container.kind != "none"):
            raise ScanError(f"no support plane in sight: what is level at z = {region.plane_z:.3f}"
                            " m lies within walls, or something lower shows through it; set "
                            "support_height_m, teach the container or give its depth "
                            "(container_inner_size_m)")
        # Integrate the stack over its opening.
        one_side = seen_from_one_side(views, region)
        stack = measure_stack(surface, found.container, region, voxel_size,
                              taught is not None or config.container_floor_m > 0, one_side)
        self.stack = stack
        self.segmenter = GivenLabelSegmenter() if self._label_images_given \
            else ContainerSegmenter(stack.container, region)
        return StackVolume(
            stamp_ns=max(v.stamp_ns for v in views),
            stack_volume=stack.stack_volume,
            stack_volume_std=stack.stack_volume_std,
            container=stack.container,
            fill_level=stack.fill_level,
            coverage=stack.coverage,
            top=stack.top,
            inner=stack.inner,
            key_view=None,
            views=ViewTally(),
            reasons=(*_quality_reasons(stack, found, one_side, scan),
                     *check_geometry(stack, region.noise, self._unit_volume),
                     *((Reason.CROWDED,)
                       if self._surroundings.are_crowded_around(stack.container) else ())),
            one_side=one_side,
            mesh=color_mesh(surface.mesh, views),
            view_agreement_m=scan.agreement_m,
            resolution_m=max(voxel_size, pixel_spacing(views, (region.low + region.high) / 2)),
            volume_parts=stack.integral.parts,
            filling_level=measure_filling_level(stack, config.filling_level_cells),
        )

    def key_view(self) -> KeyView | None:
        """Chooses the view that shows the most parts; call it after `measure`."""
        return find_key_view(self.measured_views, self.segmenter)

    def _begin_fusion(self) -> DepthFusion:
        """Finds the region in the views so far and fuses them.

        Raises:
            ScanError: no support plane, one that is not level, or nothing stands on it.
        """
        views = self.views
        # A world of pictures was turned by its support; who gives a height has a level one.
        if not self._stereo_window_m and math.isnan(self._config.support_height_m):
            require_z_up(views)
        region = replace(find_region(views, self._config), stereo_window_m=self._stereo_window_m)
        fusion = DepthFusion(region, self._config, self._unit_volume)
        if not any(self._config.roi_size_m):
            self._surroundings = inspect_surroundings(views, fusion.region)
        fused = []
        for view in views:
            try:
                fused.append(fusion.integrate(view))
            except ViewError as error:
                self._refused_late.append(error)
        self._memory.replace_all(fused)
        return fusion


def _quality_reasons(stack: MeasuredStack, found: FoundContainer, one_side: bool,
                     scan: AlignedScan) -> tuple[Reason, ...]:
    """Lists what qualifies a measured stack.

    Args:
        stack: as measured.
        found: the container as it was found.
        one_side: all views come from one side.
        scan: the views as they were measured.
    """
    is_heap, region = stack.container.kind == "none", scan.fusion.region
    reasons = {
        Reason.ONE_SIDE: one_side,
        Reason.LOW_COVERAGE: stack.coverage < SETTINGS.low_coverage,
        Reason.NOTHING_FOUND: is_heap and stack.stack_volume == 0,
        Reason.CONTAINER_UNSURE: not found.sure,
        Reason.SIZE_DISAGREES: not found.as_given,
        Reason.WALL_SHORT: not found.reaches_base,
        Reason.CUT_BY_REGION: is_heap and region.configured and stack_leaves_region(stack.top),
        Reason.CUT_BY_IMAGE: stack_leaves_every_image(scan.views, region) if is_heap
        else rim_leaves_images(stack.container, scan.views),
        Reason.VIEWS_CONTRADICT: bool(scan.left_out),
        Reason.VIEWS_APART: not scan.agree,
    }
    return tuple(reason for reason, holds in reasons.items() if holds)
