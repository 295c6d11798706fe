# SPDX-License-Identifier: Apache-2.0
"""Labels from geometry: a pixel shows parts if its own depth lies inside the container."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.container.inner_map import grown_upwards, sample_heights
from stack_counter.container.inner_surface import WallTable
from stack_counter.fusion.region import Region
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Container, View


@dataclass(frozen=True)
class ContainerSegmenterSettings:
    """How points are told apart by the container; all chosen.

    Attributes:
        surface_noise_m: points at most so far above a floor, a plane or a wall belong to it, m.
        max_gap_px: distance in the whole image up to which a pixel without depth takes the label
            of the nearest one with depth, pixels.
    """

    surface_noise_m: float = 0.003
    max_gap_px: float = 3.0


SETTINGS = ContainerSegmenterSettings()


class ContainerSegmenter:
    """Labels depth views by the fitted container and the region of interest."""

    def __init__(self, container: Container, region: Region):
        """Prepares the inner wall.

        Args:
            container: without rings, all that stands in the region is parts.
            region: what is outside of it is background.
        """
        self._container = container
        self._region = region
        self._wall = None if container.rings is None else WallTable(container)
        self._inner = None if container.inner_map is None \
            else grown_upwards(container.inner_map, SETTINGS.surface_noise_m)

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """Returns the (h, w) uint8 label image of every `stride`-th pixel.

        Depth cameras see nothing at edges: narrow gaps are closed, wide ones are background.

        Raises:
            ViewError: reason `no_depth`, if the view has none.
        """
        points = geometry.world_points(view, stride)
        return _close_gaps(self._label_points(points), np.isnan(points[..., 2]),
                           SETTINGS.max_gap_px / stride)

    def _label_points(self, points: np.ndarray) -> np.ndarray:
        """Returns the (h, w) uint8 labels of (h, w, 3) world points, metres; NaN is background."""
        noise = SETTINGS.surface_noise_m
        # Take the points of the region that stand on the support plane.
        labels = np.full(points.shape[:2], BACKGROUND, np.uint8)
        standing = self._region.contains(points) & (points[..., 2] > self._region.plane_z + noise)
        if self._wall is None:
            labels[standing] = PARTS
            return labels
        # Compare them with floor, wall and rim in the container's frame.
        container = self._container
        local = geometry.apply(geometry.inverse(container.T_world_container).astype(np.float32),
                               points[standing])
        inside = self._wall.depth_inside(local)
        rim = container.floor_thickness_m + container.inner_size_m[2]
        near = inside > -container.wall_thickness_m - 2 * noise
        if self._inner is None:
            held = (local[:, 2] > container.floor_thickness_m + noise) & (inside > noise)
        else:  # with ledges and ribs
            surface = sample_heights(self._inner, local[:, :2])
            held, near = local[:, 2] > surface + noise, near | np.isfinite(surface)
        above = local[:, 2] > rim + noise
        labels[standing] = np.select([near & (held | above), near], [PARTS, CONTAINER],
                                     BACKGROUND)
        return labels


def _close_gaps(labels: np.ndarray, gaps: np.ndarray, max_distance: float) -> np.ndarray:
    """Fills gaps with the label of the nearest pixel outside of them.

    Args:
        labels: (h, w) uint8.
        gaps: (h, w) bool.
        max_distance: farther from any such pixel is background, pixels.

    Returns:
        (h, w) uint8.
    """
    if gaps.all():
        return labels
    distance, nearest = ndimage.distance_transform_edt(gaps, return_indices=True)
    return np.where(distance <= max_distance, labels[tuple(nearest)], BACKGROUND).astype(np.uint8)
