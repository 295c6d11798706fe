# SPDX-License-Identifier: Apache-2.0
"""Depth of one camera as another camera beside it would see it.

Source: depth_image_proc's register node, which projects, keeps the nearest, and fills the holes of
a finer image with the footprints of the depth pixels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.types import Intrinsics


@dataclass(frozen=True)
class DepthRegistrationSettings:
    """How depth pixels are drawn into the other image.

    Measured on a rendered bin with balls, 0.5 m away, noise 1.5 mm, five pairs of cameras: of the
    pixels that both cameras see, 0.7% stay empty, and the mean error is 0.03 mm (without overlap
    2 to 3% empty; with the nearest depth instead of the mean -0.2 to -1 mm).

    Attributes:
        overlap_px: by so much, pixels of the other image, a footprint reaches over its border, so
            that noise and slopes do not tear the surface.
        max_footprint_px: largest width of a footprint, pixels of the other image; chosen: a time-
            of-flight camera of 160 pixels beside one of 1920.
        same_surface: depths that differ by less than this share belong to one surface; chosen:
            three sigma of a stereo camera's noise at 0.5 m.
    """

    overlap_px: float = 0.1
    max_footprint_px: int = 13
    same_surface: float = 0.01


SETTINGS = DepthRegistrationSettings()


def register_depth(depth: np.ndarray, depth_camera: Intrinsics, camera: Intrinsics,
                   T_camera_depth: np.ndarray) -> np.ndarray:
    """Returns the depth image that a camera would see, of what the depth camera has seen.

    Args:
        depth: (h, w) metres along the depth camera's optical z, 0 where invalid.
        depth_camera: calibration of `depth`, without distortion.
        camera: calibration of the camera, without distortion.
        T_camera_depth: (4, 4) from the depth camera's optical frame to the camera's.

    Returns:
        (camera.height, camera.width) float32 metres along the camera's optical z, 0 where the
        depth camera has seen nothing. Of several surfaces on one ray the nearest is kept.
    """
    # Move the points into the camera's frame and project them.
    seen = depth > 0
    z_depth = depth[seen]
    points = geometry.apply(T_camera_depth.astype(np.float32),
                            geometry.unproject(depth, depth_camera)[seen])
    pixels, z = geometry.project(points, camera)
    # The sides of a depth pixel's footprint shrink and grow with the distance and focal lengths.
    growth = z_depth / z * 0.5
    half = np.stack([growth * (camera.fx / depth_camera.fx),
                     growth * (camera.fy / depth_camera.fy)], axis=-1)
    half = np.minimum(half + SETTINGS.overlap_px, SETTINGS.max_footprint_px / 2)
    ahead = z > 0
    return _draw_nearest(pixels[ahead], half[ahead], z[ahead], camera)


def _draw_nearest(pixels: np.ndarray, half: np.ndarray, z: np.ndarray, camera: Intrinsics
                  ) -> np.ndarray:
    """Draws n rectangles of constant depth into an image; the nearest surface wins.

    Args:
        pixels: (n, 2) their centres (x, y), pixels.
        half: (n, 2) half their widths and heights, pixels.
        z: (n,) their depths, metres.
        camera: gives the size of the image.
    """
    # List all pixels of all rectangles.
    size = np.array([camera.width, camera.height])
    near = np.all((pixels > -half) & (pixels < size - 1 + half), axis=1)
    first = np.maximum(np.ceil(pixels[near] - half[near]).astype(np.int32), 0)
    last = np.minimum(np.floor(pixels[near] + half[near]).astype(np.int32), size - 1)
    z = z[near]
    covered, depths = [], []
    for dy, dx in np.ndindex(*(last - first + 1).max(axis=0, initial=0)[::-1]):
        inside = (first[:, 0] + dx <= last[:, 0]) & (first[:, 1] + dy <= last[:, 1])
        covered.append((first[inside, 1] + dy) * camera.width + first[inside, 0] + dx)
        depths.append(z[inside])
    where = np.concatenate([np.zeros(0, np.int32), *covered])
    z = np.concatenate([z[:0], *depths])
    # Keep what belongs to the nearest surface of each pixel, and average it.
    nearest = np.full(camera.height * camera.width, np.inf, np.float32)
    np.minimum.at(nearest, where, z)
    same = z < nearest[where] * (1 + SETTINGS.same_surface)
    count = np.bincount(where[same], minlength=len(nearest))
    total = np.bincount(where[same], z[same], minlength=len(nearest))
    mean = np.divide(total, count, out=np.zeros(len(nearest)), where=count > 0)
    return mean.astype(np.float32).reshape(camera.height, camera.width)
