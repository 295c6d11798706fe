# SPDX-License-Identifier: Apache-2.0
"""Outlines of container and parts in label images, as distances that a wall is fitted to.

Stereo measures nothing on a wall without texture; its outline against the background is sharp all
the same, and that of the foot shows from every side.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.types import BACKGROUND, View, WallShape, spread_views


@dataclass(frozen=True)
class OutlineSettings:
    """Where a wall is held against outlines; all chosen.

    Attributes:
        max_views: largest number of views used, evenly spread over the scan.
        ring_points: points of each ring.
        waist_share: depth of the ring between rim and foot, over the height.
        touching_share: share of that ring that touches outlines.
    """

    max_views: int = 24
    ring_points: int = 36
    waist_share: float = 0.5
    touching_share: float = 0.3


SETTINGS = OutlineSettings()


class Silhouettes:
    """The outlines of what stands on the support plane, in all views with labels."""

    def __init__(self, views: Sequence[View]):
        """Measures how far inside its outline every pixel of each view lies."""
        self._outlines = [(view.intrinsics, geometry.inverse(view.T_world_camera),
                           _signed_distances(view.labels != BACKGROUND))
                          for view in views if view.labels is not None]

    def depth_inside(self, points: np.ndarray) -> np.ndarray:
        """(n,) metres that points lie inside the outlines, of all views the least.

        Args:
            points: (n, 3) metres, world.

        Returns:
            Negative where a view sees the background there; infinite where no view looks.
        """
        least = np.full(len(points), np.inf)
        for intrinsics, T_camera_world, inside in self._outlines:
            pixels, z = geometry.project(geometry.apply(T_camera_world, points), intrinsics)
            x, y = pixels.T
            looks = (z > 0) & (x >= 0) & (x <= inside.shape[1] - 1) & (y >= 0) \
                & (y <= inside.shape[0] - 1)
            # OpenCV rounds places to 1/32 of a pixel, over which a fit finds no slope.
            distance = ndimage.map_coordinates(inside, [y, x], order=1, mode="nearest")
            metres = distance * z / intrinsics.fx
            least = np.where(looks, np.minimum(least, metres), least)
        return least


@dataclass(frozen=True, eq=False)
class WallOutlines:
    """What outlines say of the wall of a container whose rim is known.

    Attributes:
        silhouettes: of container and parts.
        rim: (n, 2) points on the outer edge of the rim, world, metres.
        height: of the rim above the support plane, metres.
        plane_z: world height of that plane, metres.
    """

    silhouettes: Silhouettes
    rim: np.ndarray
    height: float
    plane_z: float

    @classmethod
    def of_views(cls, views: Sequence[View], rim: WallShape, height: float, plane_z: float
                 ) -> WallOutlines:
        """Measures the outlines in the views' labels; the others are the attributes."""
        return cls(Silhouettes(spread_views(views, SETTINGS.max_views)),
                   _points_on_ring(rim, 0.0), height, plane_z)

    def errors(self, shape: WallShape) -> np.ndarray:
        """(m,) metres by which a wall fails: it leaves the rim, foot or waist do not touch.

        Of the waist that is asked of the places nearest to the outlines; between them, as between
        the corners of a box, it may lie inside of all, and cross none.
        """
        rim = shape.depth_inside(self.rim, np.zeros(len(self.rim)))
        rings = [np.column_stack(
            [ring := _points_on_ring(shape, share * self.height),
             np.full(len(ring), self.plane_z + (1 - share) * self.height)])
            for share in (1.0, SETTINGS.waist_share)]
        foot, waist = np.split(self.silhouettes.depth_inside(np.concatenate(rings)), 2)
        touching = waist <= np.quantile(waist, SETTINGS.touching_share)
        errors = np.concatenate([rim, foot, np.where(touching, waist, np.minimum(waist, 0))])
        return np.where(np.isfinite(errors), errors, 0)


def _points_on_ring(shape: WallShape, below: float) -> np.ndarray:
    """(ring_points, 2) points along the outer face at a depth below the rim, metres."""
    ring = shape.ring(below, 0.0)
    closed = np.concatenate([ring, ring[:1]])
    along = np.append(0, np.cumsum(np.linalg.norm(np.diff(closed, axis=0), axis=1)))
    at = np.linspace(0, along[-1], SETTINGS.ring_points, endpoint=False)
    return np.stack([np.interp(at, along, values) for values in closed.T], axis=1)


def _signed_distances(stack: np.ndarray) -> np.ndarray:
    """(h, w) float64 pixels that the pixels of a (h, w) bool mask lie inside its edge.

    The edge runs between pixels; outside of it they are negative.
    """
    inside, outside = (cv2.distanceTransform(mask.astype(np.uint8), cv2.DIST_L2,
                                             cv2.DIST_MASK_PRECISE) for mask in (stack, ~stack))
    return np.where(stack, inside - 0.5, 0.5 - outside).astype(np.float64)
