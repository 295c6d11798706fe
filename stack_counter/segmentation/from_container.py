"""Labels from geometry: a pixel shows parts if its own depth lies inside the container."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.container.inner_surface import WallTable
from stack_counter.fusion.region import Region
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Container, View

_NOISE = 0.003  # what lies less than this above floor or plane is floor or plane, m
_GAP_PX = 3.0  # pixels without depth so near to one with depth show what that one shows


class Geometric:
    """Labels depth views by the fitted container and the region of interest."""

    def __init__(self, container: Container, region: Region):
        self._container = container
        self._region = region
        self._wall = None if container.rings is None else WallTable(container)

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """(h, w) uint8 label image of every `stride`-th pixel.

        Depth cameras see nothing at edges: narrow gaps are closed, wide ones are background.

        Raises:
            ViewError: reason `no_depth`.
        """
        points = geometry.world_points(view, stride)
        return _closed(self._labels(points), np.isnan(points[..., 2]), _GAP_PX / stride)

    def _labels(self, points: np.ndarray) -> np.ndarray:
        """(h, w) uint8 label image of (h, w, 3) world points, metres; NaN is background."""
        labels = np.full(points.shape[:2], BACKGROUND, np.uint8)
        standing = self._region.contains(points) & (points[..., 2] > self._region.plane_z + _NOISE)
        if self._wall is None:
            labels[standing] = PARTS
            return labels
        box = self._container
        local = geometry.apply(geometry.inverse(box.T_world_container).astype(np.float32),
                               points[standing])
        inside = self._wall.depth_inside(local)
        rim = box.floor_thickness_m + box.inner_size_m[2]
        held = (local[:, 2] > box.floor_thickness_m + _NOISE) & (inside > _NOISE)
        above = local[:, 2] > rim + _NOISE
        near = inside > -box.wall_thickness_m - 2 * _NOISE
        labels[standing] = np.select([near & (held | above), near], [PARTS, CONTAINER],
                                     BACKGROUND)
        return labels


def _closed(labels: np.ndarray, gaps: np.ndarray, reach: float) -> np.ndarray:
    """(h, w) uint8 labels; those of (h, w) bool gaps from the nearest pixel within reach."""
    if gaps.all():
        return labels
    distance, nearest = ndimage.distance_transform_edt(gaps, return_indices=True)
    return np.where(distance <= reach, labels[tuple(nearest)], BACKGROUND).astype(np.uint8)
