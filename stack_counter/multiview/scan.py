# SPDX-License-Identifier: Apache-2.0
"""Scans of pictures and labels alone: depth by stereo, seen in a world whose z is up.

    scan = depth_scan(views, config)   # scan.views are measured as with a depth camera: volume
    if scan.is_closed(volume, config):
        volume = scan.carved(volume, config.voxel_size)
    volume = scan.in_world(volume)

Open containers and heaps are measured from above. A container is closed, like a bag that
parts show through, if labels show one and no rim is found; its V is what labels and depth leave.
If that is a ring around a basin, the container is open, and V is what lies inside the ring; if
no parts show through its sides, it may be open and full, and V holds its wall: both are unsure.

Source: paper, section 3.3: the volume is carved by pictures' masks and by depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.pixel_spacing import pixel_spacing
from stack_counter.fusion.volume_model import volume_model
from stack_counter.multiview.basin import (
    BasinFill,
    find_basin,
    measure_basin,
    sides_show_parts,
)
from stack_counter.multiview.closed_container import carve_closed_container
from stack_counter.multiview.monocular import fill_depth, load_nearness
from stack_counter.multiview.pose_refinement import refine_poses
from stack_counter.multiview.stereo import SETTINGS as STEREO_SETTINGS
from stack_counter.multiview.stereo import depth_from_pictures
from stack_counter.multiview.support_plane import fill_support_depth, find_upright
from stack_counter.multiview.visual_hull import VisualHull, carve_visual_hull
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import (
    CONTAINER,
    PARTS,
    Container,
    HeightMap,
    Mesh,
    Reason,
    StackVolume,
    View,
)


@dataclass(frozen=True)
class StereoScanSettings:
    """What a scan of pictures must show; all chosen.

    Attributes:
        max_width_px: width up to which pictures are used whole, pixels; larger ones are scaled
            down by a whole number.
        hull_voxel_m: side of the voxels of the hull that bounds the depth, m.
        min_measured_share: least share of the stack's pixels that stereo must measure.
        min_container_share: least share of the container in the stack's pixels where there is
            one.
        min_carved_share: share of a closed container's surface that stereo must measure for V
            not to be called that of the hull.
    """

    max_width_px: int = 640
    hull_voxel_m: float = 0.006
    min_measured_share: float = 0.2
    min_container_share: float = 0.02
    min_carved_share: float = 0.5


SETTINGS = StereoScanSettings()


@dataclass(frozen=True, eq=False)
class StereoScan:
    """A scan of pictures with the depth that stereo computed, in an upright world.

    Attributes:
        views: with depth and labels, upright world.
        hull: of the labels, upright world.
        T_world_upright: (4, 4) pose of the upright world in the one that the views came in.
    """

    views: list[View]
    hull: VisualHull
    T_world_upright: np.ndarray

    @property
    def window_m(self) -> float:
        """Side of the window that stereo compares, on the stack, metres."""
        return STEREO_SETTINGS.window_px * pixel_spacing(self.views, self.hull.middle)

    def is_closed(self, volume: StackVolume, config: ReconstructorConfig) -> bool:
        """Whether a container that was looked for, but has no rim, shows in the labels.

        Args:
            volume: of this scan, measured from above.
            config: settings of the reconstruction.
        """
        pixels = [np.bincount(require_labels(view).ravel(), minlength=3)[:3]
                  for view in self.views]
        _, container, parts = np.sum(pixels, axis=0)
        return volume.container.kind == "none" and config.container_kind == "auto" \
            and container > SETTINGS.min_container_share * (container + parts)

    def carved(self, heap: StackVolume, voxel_size: float) -> StackVolume:
        """Measures the same scan as a closed container.

        Args:
            heap: its volume as a heap, whose frame stands on the support plane.
            voxel_size: smallest side of a voxel, metres.

        Raises:
            ScanError: no voxel is left after carving.
        """
        # Carve by labels and depth above the support plane.
        plane_z = float(heap.container.T_world_container[2, 3])
        found = carve_closed_container(self.views, self.hull, voxel_size, plane_z)
        # Where stereo measured little of the surface, V is that of the hull.
        measured = found.measured_share >= SETTINGS.min_carved_share
        reasons: tuple[Reason, ...] = () if measured else (Reason.NO_DEPTH,)
        # What views look into is open after all: only its inside counts.
        basin, top = find_basin(found.top), found.top
        stack = BasinFill(top, replace(top, heights=np.zeros_like(top.heights)), found.volume,
                          found.volume_std)
        if basin is not None:
            stack = measure_basin(basin, top, found.volume_std)
        if basin is not None or not sides_show_parts(self.views, found.surface):
            reasons += (Reason.CONTAINER_UNSURE,)
        return replace(
            heap, stack_volume=stack.volume, stack_volume_std=stack.volume_std, top=stack.top,
            inner=stack.inner, coverage=found.measured_share, fill_level=(0.0, 0.0, 0.0),
            reasons=reasons, one_side=False, volume_parts={}, filling_level=None,
            container=Container("hull", geometry.pose(np.eye(3), self.hull.middle)),
            mesh=Mesh(found.surface.astype(np.float32), np.zeros((0, 3), np.int32)))

    def in_world(self, volume: StackVolume) -> StackVolume:
        """Returns a volume of the upright world in the one that the views came in.

        Stereo's own error is added to its standard deviation, and the reason that names it; the
        surface resolves its window at best.
        """
        T = self.T_world_upright

        def in_world(heights: HeightMap | None) -> HeightMap | None:
            return heights and replace(heights, T_world_map=T @ heights.T_world_map)

        container, mesh, key_view = volume.container, volume.mesh, volume.key_view
        return replace(
            volume, top=in_world(volume.top), inner=in_world(volume.inner),
            resolution_m=max(volume.resolution_m, self.window_m),
            stack_volume_std=float(np.hypot(volume.stack_volume_std,
                                            volume_model().stereo_std * volume.stack_volume)),
            container=replace(container, T_world_container=T @ container.T_world_container),
            mesh=mesh and replace(mesh, vertices=geometry.apply(T, mesh.vertices).astype(
                np.float32)),
            key_view=key_view and replace(key_view, T_world_camera=T @ key_view.T_world_camera),
            reasons=(Reason.DEPTH_FROM_PICTURES, *(  # stereo sees little of a wall's foot
                reason for reason in volume.reasons if reason != Reason.WALL_SHORT)))


def depth_scan(views: list[View], config: ReconstructorConfig) -> StereoScan:
    """Computes depth by stereo, inside the hull of the labels.

    Args:
        views: pinhole views with colour and labels.
        config: settings of the reconstruction.

    Raises:
        ScanError: no hull, stereo sees too little of the stack, or no support to say what is up.
        ViewError: reasons `no_color`, `no_labels`.
        WeightsError: the weights of Depth Anything that are named cannot be loaded.
    """
    # Refine the poses at the size that stereo works on.
    smaller = [scale_down(view, -(-view.intrinsics.width // SETTINGS.max_width_px))
               for view in views]
    refined = refine_poses(smaller)
    # Carve the hull of the labels, and compute depth inside it.
    hull = carve_visual_hull(refined, max(config.voxel_size, SETTINGS.hull_voxel_m),
                             config.hull_min_share)
    with_depth = depth_from_pictures(refined, hull)
    if config.depth_weights:
        with_depth = fill_depth(with_depth, load_nearness(Path(config.depth_weights)))
    stack_depths = np.concatenate([
        np.asarray(view.depth)[np.isin(require_labels(view), (CONTAINER, PARTS))]
        for view in with_depth])
    measured_share = (stack_depths > 0).mean()
    if measured_share < SETTINGS.min_measured_share:
        raise ScanError(f"stereo measures {measured_share:.0%} of the stack; expected "
                        f"{SETTINGS.min_measured_share:.0%} or more")
    # Turn all into a world whose z is the support's normal.
    support = find_upright(with_depth)
    T = support.T_upright_world
    upright = [replace(view, T_world_camera=T @ view.T_world_camera) for view in with_depth]
    upright_views = [fill_support_depth(view, support.plane_z) for view in upright]
    upright_hull = replace(hull, middle=geometry.apply(T, hull.middle),
                           surface=geometry.apply(T, hull.surface))
    return StereoScan(upright_views, upright_hull, geometry.inverse(T))


def scale_down(view: View, factor: int) -> View:
    """Scales the images and the calibration of a view down.

    Args:
        view: without distortion.
        factor: how many times smaller; colour is averaged over factor x factor pixels, depth and
            labels are those of a middle one.
    """
    n = factor
    if n == 1:
        return view
    k = view.intrinsics
    w, h = k.width // n, k.height // n
    # Pixel centres lie on whole numbers: the middle of the first n is at (n - 1) / 2.
    intrinsics = replace(k, width=w, height=h, fx=k.fx / n, fy=k.fy / n,
                         cx=(k.cx - (n - 1) / 2) / n, cy=(k.cy - (n - 1) / 2) / n)

    def middle(image: np.ndarray | None) -> np.ndarray | None:
        return None if image is None else np.ascontiguousarray(
            image[n // 2::n, n // 2::n][:h, :w])

    color = view.color if view.color is None else cv2.resize(
        view.color[:h * n, :w * n], (w, h), interpolation=cv2.INTER_AREA)
    return replace(view, intrinsics=intrinsics, color=color, depth=middle(view.depth),
                   labels=middle(view.labels))
