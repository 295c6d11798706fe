# SPDX-License-Identifier: Apache-2.0
"""Whether a scan can be right at all: one container, and not cut off."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.types import Container, HeightMap, View


@dataclass(frozen=True)
class PlausibilitySettings:
    """When a scan is refused or flagged; all values are chosen.

    Attributes:
        border_px: width of an image's border, pixels.
        max_border_share: largest share of the border that may show something standing.
        max_unseen_rim: largest share of a container's rim that may lie beyond all images.
    """

    border_px: int = 3
    max_border_share: float = 0.02
    max_unseen_rim: float = 0.03


SETTINGS = PlausibilitySettings()


def stack_leaves_every_image(views: list[View], region: Region) -> bool:
    """Whether every view shows something standing on the support plane at its image's border."""
    return all(_is_cut(view, region) for view in views)


def _is_cut(view: View, region: Region) -> bool:
    """Whether something that stands in the region reaches the border of a view's image."""
    points = geometry.world_points(view)
    standing = region.contains(points) & (points[..., 2] > region.plane_z + region.noise_height)
    b = SETTINGS.border_px
    border = [standing[:b], standing[-b:], standing[:, :b], standing[:, -b:]]
    share = np.concatenate([strip.ravel() for strip in border]).mean()
    return bool(share > SETTINGS.max_border_share)


def rim_leaves_images(container: Container, views: list[View]) -> bool:
    """Whether some of a container's rim lies beyond the images of all views.

    Args:
        container: with rings.
        views: cropped to a region with room around the container.
    """
    assert container.rings is not None  # for the type checker
    rim = geometry.apply(container.T_world_container, container.rings[-1])
    seen = np.zeros(len(rim), bool)
    for view in views:
        local = geometry.apply(geometry.inverse(view.T_world_camera), rim)
        pixels, depth = geometry.project(local, view.intrinsics)
        size = np.array([view.intrinsics.width, view.intrinsics.height])
        seen |= (depth > 0) & np.all((pixels > 0) & (pixels < size - 1), axis=1)
    return bool(np.mean(~seen) > SETTINGS.max_unseen_rim)


def stack_leaves_region(top: HeightMap) -> bool:
    """Whether a heap reaches the border of the region of interest.

    Args:
        top: map of the region; NaN beside the heap.
    """
    heap = np.isfinite(top.heights)
    border = np.concatenate([heap[:2].ravel(), heap[-2:].ravel(), heap[:, :2].ravel(),
                             heap[:, -2:].ravel()])
    return bool(border.mean() > SETTINGS.max_border_share)
