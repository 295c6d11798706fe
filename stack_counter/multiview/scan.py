"""Scans of pictures and labels alone: depth by stereo, seen in a world whose z is up.

    scan = depth_scan(views, config)        # then as with a depth camera, in scan's own world
    if scan.is_closed(volume, config):
        volume = scan.carved(volume, config.voxel_size)
    volume = scan.in_world(volume)

Open containers and heaps are measured from above, as ever. A container is closed, like a bag that
parts show through, if labels show one and no rim is found; its V is what labels and depth leave.

Source: paper, section 3.3: the volume is carved by pictures' masks and by depth.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.volume_model import volume_model
from stack_counter.multiview.closed_container import carve_closed_container
from stack_counter.multiview.pose_refinement import refine_poses
from stack_counter.multiview.stereo import depth_from_pictures
from stack_counter.multiview.support_plane import find_upright, show_support
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

_MAX_WIDTH = 640  # larger pictures are made a whole number of times smaller, pixels
_HULL_VOXEL = 0.006  # of the hull that bounds the depth, m
_MIN_MEASURED = 0.2  # share of the stack's pixels that stereo must measure
_MIN_CONTAINER = 0.02  # share of the stack's pixels that show the container, where there is one
_MOSTLY = 0.5  # share of a closed container's surface that stereo should measure


@dataclass(frozen=True)
class StereoScan:
    """Views with depth and labels, the hull of the labels, both in an upright world, and its pose
    (4, 4) in the world that the views came in."""

    views: list[View]
    hull: VisualHull
    T_world_upright: np.ndarray

    def is_closed(self, volume: StackVolume, config: ReconstructorConfig) -> bool:
        """Whether a container that was looked for, but has no rim, shows in the labels."""
        shown = [np.bincount(require_labels(view).ravel(), minlength=3)[:3] for view in self.views]
        _, container, parts = np.sum(shown, axis=0)
        return volume.container.kind == "none" and config.container_kind == "auto" \
            and container > _MIN_CONTAINER * (container + parts)

    def carved(self, heap: StackVolume, voxel_size: float) -> StackVolume:
        """The same scan as a closed container.

        Args:
            heap: its volume as a heap, whose frame stands on the support plane.
            voxel_size: metres.

        Raises:
            ScanError: nothing is left.
        """
        plane_z = float(heap.container.T_world_container[2, 3])
        found = carve_closed_container(self.views, self.hull, voxel_size, plane_z)
        inner = HeightMap(found.top.T_world_map, found.top.pitch, np.zeros_like(found.top.heights))
        reasons = () if found.measured >= _MOSTLY else (Reason.NO_DEPTH,)  # there the hull stands
        return replace(
            heap, stack_volume=found.volume, stack_volume_std=found.volume_std, top=found.top,
            inner=inner, coverage=found.measured, fill_level=(0.0, 0.0, 0.0), reasons=reasons,
            one_side=False,
            container=Container("hull", geometry.pose(np.eye(3), self.hull.middle)),
            mesh=Mesh(found.surface.astype(np.float32), np.zeros((0, 3), np.int32)))

    def in_world(self, volume: StackVolume) -> StackVolume:
        """The volume where the views came from, with stereo's error and named as such."""
        T = self.T_world_upright

        def moved(heights: HeightMap | None) -> HeightMap | None:
            return heights and replace(heights, T_world_map=T @ heights.T_world_map)

        box, mesh, key = volume.container, volume.mesh, volume.key_view
        return replace(
            volume, top=moved(volume.top), inner=moved(volume.inner),
            stack_volume_std=float(np.hypot(volume.stack_volume_std,
                                            volume_model().stereo_std * volume.stack_volume)),
            container=replace(box, T_world_container=T @ box.T_world_container),
            mesh=mesh and replace(mesh, vertices=geometry.apply(T, mesh.vertices).astype(
                np.float32)),
            key_view=key and replace(key, T_world_camera=T @ key.T_world_camera),
            reasons=(Reason.DEPTH_FROM_PICTURES, *volume.reasons))


def depth_scan(views: list[View], config: ReconstructorConfig) -> StereoScan:
    """Depth by stereo, inside the hull of the labels.

    Args:
        views: pinhole views with colour and labels.

    Raises:
        ScanError: no hull, stereo sees too little of the stack, or no support to say what is up.
        ViewError: reasons `no_color`, `no_labels`.
    """
    smaller = [scale_down(view, -(-view.intrinsics.width // _MAX_WIDTH)) for view in views]
    refined = refine_poses(smaller)
    hull = carve_visual_hull(refined, max(config.voxel_size, _HULL_VOXEL), config.hull_min_share)
    deep = depth_from_pictures(refined, hull)
    known = (
        np.concatenate(
            [
                np.asarray(view.depth)[np.isin(require_labels(view), (CONTAINER, PARTS))]
                for view in deep
            ]
        )
        > 0
    )
    if known.mean() < _MIN_MEASURED:
        raise ScanError(f"stereo measures {known.mean():.0%} of the stack; expected "
                        f"{_MIN_MEASURED:.0%} or more")
    T, plane_z = find_upright(deep)
    upright = [show_support(replace(view, T_world_camera=T @ view.T_world_camera), plane_z)
               for view in deep]
    turned = replace(hull, middle=geometry.apply(T, hull.middle),
                     surface=geometry.apply(T, hull.surface))
    return StereoScan(upright, turned, geometry.inverse(T))


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
