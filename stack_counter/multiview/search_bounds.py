# SPDX-License-Identifier: Apache-2.0
"""Where stereo searches the surface: inside the hull of the labels, and on the support."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.multiview.visual_hull import VisualHull
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, View


@dataclass(frozen=True)
class SearchSettings:
    """Which pixels get depth, and where it is searched; all chosen.

    Attributes:
        edge: width of what is left open beside the edges that labels show, pixels.
        support: width of the ring of background around the stack that gets depth too, as a share
            of the stack's largest side in the picture.
        support_room: how far behind the hull the ring's depth is searched, in depths of the hull.
    """

    edge: int = 2
    support: float = 0.1
    support_room: float = 0.5


SETTINGS = SearchSettings()


def hull_bounds(view: View, hull: VisualHull) -> tuple[np.ndarray, np.ndarray]:
    """Returns the nearest and the farthest depth of the hull at every pixel.

    Args:
        view: of which pose and calibration are used.
        hull: in the same world.

    Returns:
        Two (h, w) float32 images, metres, 0 where the hull is not.
    """
    # Project the surface's voxels.
    k = view.intrinsics
    pixels = geometry.project_into(view, hull.surface)
    near = np.full((k.height, k.width), np.inf, np.float32)
    far = np.zeros((k.height, k.width), np.float32)
    if not pixels.inside.any():
        return far, far
    z = pixels.depth.astype(np.float32)
    np.minimum.at(near, (pixels.rows, pixels.cols), z - hull.voxel_size)
    np.maximum.at(far, (pixels.rows, pixels.cols), z + hull.voxel_size)
    # Each voxel covers several pixels; a pixel more keeps the surface inside the bounds.
    reach = 1 + int(np.ceil(hull.voxel_size * k.fx / np.median(z)))
    kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
    near, far = cv2.erode(near, kernel), cv2.dilate(far, kernel)
    return np.where(far > 0, near, 0).astype(np.float32), far


def search_bounds(view: View, hull: VisualHull) -> tuple[np.ndarray, np.ndarray]:
    """Returns the bounds of the depth that is searched: the hull's, and the support's around it.

    Args:
        view: with labels.
        hull: of the labels of all views.

    Returns:
        Nearest and farthest depth, (h, w) float32 metres each, 0 where none is searched.

    Raises:
        ViewError: reason `no_labels`.
    """
    labels = require_labels(view)
    near, far = hull_bounds(view, hull)
    # Search the stack, except beside the rim.
    shown = np.isin(labels, (CONTAINER, PARTS)) & (far > 0)
    # Windows and paths carry a rim's depth over its edge.
    rim = cv2.dilate((labels == CONTAINER).astype(np.uint8), np.ones((2 * SETTINGS.edge + 1,) * 2))
    shown &= (labels == CONTAINER) | (rim == 0)
    if not shown.any():
        return np.zeros_like(near), np.zeros_like(far)
    low, high = float(near[shown].min()), float(far[shown].max())
    near, far = np.where(shown, near, 0), np.where(shown, far, 0)
    # Search the ring of background around it in the depths of the whole stack, and behind.
    distance = cv2.distanceTransform((~shown).astype(np.uint8), cv2.DIST_L2, 5)
    width = SETTINGS.support * max(np.ptp(np.nonzero(shown), axis=1))
    ring = (distance > SETTINGS.edge) & (distance <= width) & (labels == BACKGROUND)
    near[ring], far[ring] = low, high + SETTINGS.support_room * (high - low)
    return near, far
