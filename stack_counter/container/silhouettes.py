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
        labelled, maps = [], []
        for view in views:
            if view.labels is not None:
                labelled.append(view)
                maps.append(_signed_distances(view.labels != BACKGROUND))
        # Maps of any sizes lie one behind the other: one look-up serves all views.
        self._inside = np.concatenate([np.zeros(0), *map(np.ravel, maps)])
        sizes = np.array([inside.shape for inside in maps], int).reshape(-1, 2)  # (v, 2)
        self._height, self._width = sizes.T[..., None]  # (v, 1), as all below
        self._first = (np.cumsum(sizes.prod(axis=1)) - sizes.prod(axis=1))[:, None]
        self._T_camera_world = np.array([geometry.inverse(view.T_world_camera)
                                         for view in labelled]).reshape(-1, 4, 4)
        self._fx, self._fy, self._cx, self._cy = np.array(
            [(k.fx, k.fy, k.cx, k.cy) for k in (view.intrinsics for view in labelled)]
        ).reshape(-1, 4).T[..., None]

    def depth_inside(self, points: np.ndarray) -> np.ndarray:
        """(n,) metres that points lie inside the outlines, of all views the least.

        Args:
            points: (n, 3) metres, world.

        Returns:
            Negative where a view sees the background there; infinite where no view looks.
        """
        T = self._T_camera_world
        x, y, z = np.moveaxis(points @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3], -1, 0)
        with np.errstate(divide="ignore", invalid="ignore"):
            x = x / z * self._fx + self._cx  # (v, n) pixels
            y = y / z * self._fy + self._cy
            looks = (z > 0) & (x >= 0) & (x <= self._width - 1) \
                & (y >= 0) & (y <= self._height - 1)
        distance = self._between_pixels(np.where(looks, x, 0), np.where(looks, y, 0))
        return np.where(looks, distance * z / self._fx, np.inf).min(axis=0, initial=np.inf)

    def _between_pixels(self, x: np.ndarray, y: np.ndarray) -> np.ndarray:
        """(v, n) pixels inside the outlines at (v, n) places in the images, linear in between.

        OpenCV rounds places to 1/32 of a pixel, over which a fit finds no slope; SciPy takes one
        image at a time, which costs a fit most of its time.
        """
        col = np.minimum(x.astype(int), self._width - 2)
        row = np.minimum(y.astype(int), self._height - 2)
        left, top = 1 - (x - col), 1 - (y - row)
        at = self._first + row * self._width + col
        below = at + self._width
        return (self._inside[at] * top * left + self._inside[at + 1] * top * (1 - left)
                + self._inside[below] * (1 - top) * left
                + self._inside[below + 1] * (1 - top) * (1 - left))


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
