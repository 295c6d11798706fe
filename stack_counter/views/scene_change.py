# SPDX-License-Identifier: Apache-2.0
"""What has changed between two views of nearly the same place, the camera's small motion apart.

Two views are compared at the size of a thumbnail. A camera that has moved a little sees the same
things a little shifted: what lies within the range of values around a pixel is no change. Of what
is left, one place counts, not the whole: one part that is taken away is a change, noise is none.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.types import View


@dataclass(frozen=True)
class SceneChangeSettings:
    """How two views are compared; measured on renderings of `data/train-*`, with noise.

    With a noise of 5 grey levels and the simulator's depth noise, pictures from one pose change by
    2 grey levels at most and depths by 0.002 per m; one part of 1 to 12 cm3 that is taken away
    changes them by 34 and 0.016 or more, and by 20 and 0.008 after a motion of 0.7 mm.

    Attributes:
        thumbnail_px: width and height at which views are compared, pixels: parts still show,
            noise does not.
        patch_px: size of the window over which a change is averaged, pixels of the thumbnail:
            one part that is taken away fills it.
        shift_margin: a motion explains so many times the shift that it makes in the middle of the
            image: more near the borders, and of what lies nearer.
        depth_edge_px: shift that always explains a depth, pixels of the thumbnail: edges of depth
            images are never at rest.
        nearest_share: share of the depths that may be nearer than the distance for which a shift
            is computed.
        distance_m: that distance where there is no depth, metres.
        valid_share: share of the pixels under one of the thumbnail that need a depth.
        exposure: largest ratio of the brightness of two pictures that counts as exposure or light.
    """

    thumbnail_px: tuple[int, int] = (160, 120)
    patch_px: tuple[int, int] = (5, 5)
    shift_margin: float = 1.5
    depth_edge_px: float = 0.25
    nearest_share: float = 0.02
    distance_m: float = 0.3
    valid_share: float = 0.5
    exposure: float = 2.0


SETTINGS = SceneChangeSettings()


@dataclass(frozen=True, eq=False)
class Thumbnail:
    """A view at the size at which views are compared.

    Attributes:
        T_world_camera: (4, 4) pose of the optical frame.
        focal_px: focal length, pixels of the thumbnail.
        grey: (h, w) float32 grey levels.
        depth: (h, w) float32, metres, NaN where there is none; None for a view without depth.
        nearest_m: distance of the nearest things in sight, metres.
    """

    T_world_camera: np.ndarray
    focal_px: float
    grey: np.ndarray
    depth: np.ndarray | None
    nearest_m: float


def make_thumbnail(view: View, grey: np.ndarray) -> Thumbnail:
    """Makes the thumbnail of a view, of which `grey` (h, w) uint8 is the picture."""
    width, height = SETTINGS.thumbnail_px
    k, depth, nearest = view.intrinsics, None, SETTINGS.distance_m
    if view.depth is not None:
        depth = _shrink_depth(np.asarray(view.depth))
        if np.isfinite(depth).any():
            nearest = float(np.nanquantile(depth, SETTINGS.nearest_share))
    return Thumbnail(
        view.T_world_camera, max(k.fx * width / k.width, k.fy * height / k.height),
        cv2.resize(grey, (width, height), interpolation=cv2.INTER_AREA).astype(np.float32),
        depth, nearest)


def picture_change(before: Thumbnail, after: Thumbnail, motion: tuple[float, float]
                   ) -> float:
    """Largest change of the picture that neither motion nor exposure explains, grey levels.

    `motion`: distance, metres, and angle, radians, between the two poses.
    """
    low, high = _range_around(before.grey, _shift_px(after, motion))
    bright, brighter = np.maximum(before.grey, 1), np.maximum(after.grey, 1)
    ratio = float(np.median(brighter / bright))
    if 1 / SETTINGS.exposure < ratio < SETTINGS.exposure:
        low, high = low * ratio, high * ratio
    beyond = np.maximum(np.maximum(after.grey - high, low - after.grey), 0)
    return float(cv2.blur(beyond, SETTINGS.patch_px).max())


def depth_change(before: Thumbnail, after: Thumbnail, motion: tuple[float, float]
                 ) -> float:
    """Largest change of depth that motion does not explain, over the depth squared, 1/m.

    Noise of a depth camera grows with the square of the depth. 0 where a view has no depth.
    `motion`: distance, metres, and angle, radians, between the two poses.
    """
    if before.depth is None or after.depth is None:
        return 0.0
    both = np.isfinite(before.depth) & np.isfinite(after.depth)
    depth = np.where(both, after.depth, 1).astype(np.float32)
    distance, angle = motion
    low, high = _range_around(before.depth, _shift_px(after, motion) + SETTINGS.depth_edge_px)
    slack = SETTINGS.shift_margin * (distance + angle * depth)
    beyond = np.where(both, np.maximum(depth - high - slack, 0)
                      - np.maximum(low - depth - slack, 0), 0)
    return float(np.abs(cv2.blur(beyond / depth**2, SETTINGS.patch_px)).max())


def _shift_px(thumbnail: Thumbnail, motion: tuple[float, float]) -> float:
    """Largest shift that a motion of the camera explains, pixels of the thumbnail."""
    distance, angle = motion
    return SETTINGS.shift_margin * thumbnail.focal_px * (distance / thumbnail.nearest_m + angle)


def _range_around(image: np.ndarray, shift_px: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest value that each pixel may have after a shift: (h, w) float32 each.

    NaN has no say; what comes into the image over its border may have any value. Between whole
    pixels the range grows in proportion.
    """
    reach = int(np.ceil(shift_px))
    if not reach:
        return image, image
    known, window = np.isfinite(image), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
    low = cv2.erode(np.where(known, image, np.inf).astype(np.float32), window,
                    borderType=cv2.BORDER_CONSTANT, borderValue=-np.inf)
    high = cv2.dilate(np.where(known, image, -np.inf).astype(np.float32), window,
                      borderType=cv2.BORDER_CONSTANT, borderValue=np.inf)
    share = shift_px / reach
    with np.errstate(invalid="ignore"):  # infinite where no pixel around has a value
        return image + share * (low - image), image + share * (high - image)


def _shrink_depth(depth: np.ndarray) -> np.ndarray:
    """Mean of the valid depths under each pixel of the thumbnail, NaN where too few are valid."""
    valid = (depth > 0).astype(np.float32)
    size, area = SETTINGS.thumbnail_px, cv2.INTER_AREA
    share = cv2.resize(valid, size, interpolation=area)
    total = cv2.resize(depth.astype(np.float32) * valid, size, interpolation=area)
    return np.where(share >= SETTINGS.valid_share, total / np.maximum(share, 1e-6), np.nan)
