# SPDX-License-Identifier: Apache-2.0
"""What is done to a depth image before it is fused: clipped, smoothed, its background opened."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter.errors import ViewError
from stack_counter.types import BACKGROUND, View


@dataclass(frozen=True)
class DepthFilterSettings:
    """How depth images are smoothed.

    Attributes:
        diameter_px: diameter of the bilateral filter's window, pixels; chosen.
        range_noise: standard deviation of its range kernel over that of the depth's noise, so
            that steps larger than noise stay; chosen.
        spatial_px: standard deviation of its spatial kernel, pixels; chosen.
        background_share: share of the farthest depth used at which background without depth is
            put; below 1, so that the TSDF takes it.
    """

    diameter_px: int = 5
    range_noise: float = 3.0
    spatial_px: float = 1.5
    background_share: float = 0.99


SETTINGS = DepthFilterSettings()


def clip_depth(view: View, nearest: float, farthest: float) -> View:
    """Returns the view with depth outside the working range set to 0, which is invalid.

    Args:
        view: a view with depth.
        nearest, farthest: limits of the working range, metres.

    Raises:
        ViewError: reason `empty_depth`, if no pixel is left.
    """
    depth = np.asarray(view.depth)
    valid = (depth >= nearest) & (depth <= farthest)
    if not valid.any():
        seen = f"half of it is beyond {np.median(depth[depth > 0]):.3g} m" if (depth > 0).any() \
            else "no pixel is valid"
        raise ViewError("empty_depth", f"no depth between {nearest} and {farthest} m, {seen}; "
                                       "expected some: set depth_scale (metres a unit of depth, "
                                       "e.g. 0.0001) if the camera is nearer, else depth_min or "
                                       "depth_trunc")
    return replace(view, depth=np.where(valid, depth, 0).astype(np.float32))


def smooth_depth(depth: np.ndarray, noise: float) -> np.ndarray:
    """Averages noise inside surfaces and keeps the steps between them.

    Args:
        depth: (h, w) float32, metres; 0 is invalid and stays so.
        noise: standard deviation of single depth values, metres; 0 leaves the image as it is.

    Returns:
        (h, w) float32, metres.
    """
    if noise <= 0:
        return depth
    s = SETTINGS
    smoothed = cv2.bilateralFilter(depth, s.diameter_px, s.range_noise * noise, s.spatial_px)
    return np.where(depth > 0, smoothed, 0).astype(np.float32)


def open_background(view: View, farthest: float) -> np.ndarray:
    """Puts background pixels without depth far away.

    A ray that ends in the background proves its whole length empty, so that it carves.

    Args:
        view: a view with depth, and with labels or without.
        farthest: farthest depth that is fused, metres.

    Returns:
        (h, w) float32 depth, metres.
    """
    depth = np.asarray(view.depth)
    if view.labels is None:
        return depth
    background = (view.labels == BACKGROUND) & (depth == 0)
    return np.where(background, np.float32(SETTINGS.background_share * farthest), depth)
