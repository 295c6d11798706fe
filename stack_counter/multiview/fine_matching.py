# SPDX-License-Identifier: Apache-2.0
"""Depth of a large picture, matched in a narrow band around that of the picture made smaller.

The plane sweep's time grows with the third power of the width. What it finds in a smaller picture
says where the surface is to a few pixels of disparity: only those are tried here, each on a plane
slanted as the coarse surface is.

Source: Rothermel et al., "SURE: Photogrammetric surface reconstruction from imagery" (2012), whose
coarse-to-fine semi-global matching this is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.multiview.band_kernels import (
    Band,
    Neighbours,
    add_band_paths,
    match_band,
    pick_in_band,
)
from stack_counter.multiview.plane_sweep import Picture


@dataclass(frozen=True)
class FineSettings:
    """How pictures are compared in the band; all chosen.

    Attributes:
        planes: number of planes in the band of a pixel.
        reach_px: half side of the window in which the coarse depths bound the band, pixels.
        room: planes on either side of those bounds.
        slope_px: half side of the window in which the coarse surface's slope is taken, pixels.
        radius: of the correlation window, pixels.
        grey_noise: standard deviation of a grey level that is noise.
        edge_grey: difference of grey levels that halves the cost of a jump of depth.
        step_cost, jump_cost: costs of a step by one plane and of a larger jump between
            neighbouring pixels.
        min_margin: lowest share by which the second best depth must cost more.
    """

    planes: int = 20
    reach_px: int = 3
    room: int = 4
    slope_px: int = 6
    radius: int = 1
    grey_noise: float = 2.0
    edge_grey: float = 8.0
    step_cost: float = 60.0
    jump_cost: float = 600.0
    min_margin: float = 0.02


SETTINGS = FineSettings()


def match_finely(picture: Picture, neighbours: Sequence[Picture], coarse: np.ndarray,
                 searched: np.ndarray, planes: np.ndarray, settings: FineSettings = SETTINGS
                 ) -> np.ndarray:
    """Returns where among planes a picture agrees best with its neighbours.

    Args:
        picture: the reference.
        neighbours: pictures of the same surface from elsewhere; one or more.
        coarse: (h, w) float32 metres, 0 where unknown; some of it known.
        searched: (h, w) bool, pixels that get depth.
        planes: (d,) float64 inverse depths, 1/m, evenly spaced from far to near.
        settings: how pictures are compared.

    Returns:
        (h, w) float32 positions among the planes, -1 where unknown.
    """
    band = _find_band(coarse, searched, planes, settings)
    cost = match_band(picture.grey, _side_by_side(picture, neighbours), band, settings.radius,
                      settings.grey_noise, (len(neighbours) + 1) // 2)
    # Aggregate the costs along paths, four of them downwards and four upwards.
    total = np.zeros(cost.shape, np.float32)
    for forwards in (True, False):
        add_band_paths(cost, picture.grey, band.start, total, settings.step_cost,
                       settings.jump_cost, settings.edge_grey, forwards)
    return pick_in_band(total, band.start, searched, len(planes), settings.min_margin)


def _find_band(coarse: np.ndarray, searched: np.ndarray, planes: np.ndarray,
               settings: FineSettings) -> Band:
    """Returns the planes around a coarse surface, see `match_finely`."""
    # Fill the coarse depth from the nearest known, and find the bounds beside each pixel.
    nearest = ndimage.distance_transform_edt(coarse <= 0, return_distances=False,
                                             return_indices=True)
    step = (planes[-1] - planes[0]) / (len(planes) - 1)
    position = ((1 / coarse[tuple(nearest)] - planes[0]) / step).astype(np.float32)
    kernel = np.ones((2 * settings.reach_px + 1,) * 2, np.uint8)
    low = cv2.erode(position, kernel) - settings.room
    high = cv2.dilate(position, kernel) + settings.room
    # Where they are too far apart, the band lies around the pixel's own depth.
    half = (settings.planes - 1) / 2
    middle = np.where(high - low > 2 * half, np.clip(position, low + half, high - half),
                      (low + high) / 2)
    return Band(np.round(middle - half).astype(np.int32), settings.planes, searched,
                _slopes(position, settings) * np.float32(step), float(planes[0]), float(step))


def _slopes(position: np.ndarray, settings: FineSettings) -> np.ndarray:
    """Returns (h, w, 2) float32 derivatives of an image (h, w) along columns and rows."""
    side = 2 * settings.slope_px + 1
    smooth = cv2.blur(position, (side, side))
    return np.stack([cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8),
                     cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)], axis=-1)


def _side_by_side(picture: Picture, neighbours: Sequence[Picture]) -> Neighbours:
    """Returns pictures and maps into them as the compiled loops take them."""
    sizes = np.array([other.grey.shape for other in neighbours], np.int32)
    greys = np.zeros((len(neighbours), *sizes.max(axis=0)), np.float32)
    to_other, shift = [], []
    for i, other in enumerate(neighbours):
        greys[i, :sizes[i, 0], :sizes[i, 1]] = other.grey
        T = geometry.inverse(other.T_world_camera) @ picture.T_world_camera
        to_other.append(other.K @ T[:3, :3] @ np.linalg.inv(picture.K))
        shift.append(other.K @ T[:3, 3])
    return Neighbours(greys, sizes, np.array(to_other, np.float32), np.array(shift, np.float32))
