"""Labels from geometry: a pixel shows parts if its own depth lies inside the container."""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.region import Region, world_points
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Container, View

_NOISE = 0.004  # what lies less than this above floor or plane is floor or plane, m


class Geometric:
    """Labels depth views by the fitted container and the region of interest."""

    def __init__(self, container: Container, region: Region):
        self._container = container
        self._region = region

    def segment(self, view: View, stride: int = 1) -> np.ndarray:
        """(h, w) uint8 label image of every `stride`-th pixel; no depth counts as background.

        Raises:
            ViewError: reason `no_depth`.
        """
        points = world_points(view, stride)
        labels = np.full(points.shape[:2], BACKGROUND, np.uint8)
        standing = self._region.holds(points) & (points[..., 2] > self._region.plane_z + _NOISE)
        box = self._container
        if box.kind != "box":
            labels[standing] = PARTS
            return labels
        local = geometry.apply(geometry.inverse(box.T_world_container).astype(np.float32), points)
        beside = np.abs(local[..., :2]) - np.array(box.inner_size_m[:2], np.float32) / 2
        outwards = beside.max(axis=-1)  # distance outside the inner walls, m
        rim = box.floor_thickness_m + box.inner_size_m[2]
        inside = (outwards < -_NOISE) | (local[..., 2] > rim + _NOISE)
        walls = standing & (outwards < box.wall_thickness_m + 2 * _NOISE)
        labels[walls] = CONTAINER
        labels[walls & inside & (local[..., 2] > box.floor_thickness_m + _NOISE)] = PARTS
        return labels
