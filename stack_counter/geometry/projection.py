# SPDX-License-Identifier: Apache-2.0
"""From points to pixels of a pinhole camera and back."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.errors import ViewError
from stack_counter.geometry.poses import apply, inverse
from stack_counter.types import Intrinsics, View


def project(points: np.ndarray, intrinsics: Intrinsics) -> tuple[np.ndarray, np.ndarray]:
    """Pinhole projection.

    Args:
        points: (..., 3) metres, optical frame.
        intrinsics: without distortion.

    Returns:
        (..., 2) pixel coordinates (x, y) and (...) depth in metres; pixels are not finite or
        meaningless where depth <= 0.
    """
    z = points[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        u = points[..., 0] / z * intrinsics.fx + intrinsics.cx
        v = points[..., 1] / z * intrinsics.fy + intrinsics.cy
    return np.stack([u, v], axis=-1), z


@dataclass(frozen=True, eq=False)
class ProjectedPoints:
    """Where n points of the world fall in a view's image; m of them fall inside it.

    Attributes:
        inside: (n,) bool, the points in front of the camera whose nearest pixel exists.
        rows, cols: (m,) int64 nearest pixels of the points inside, in their order.
        depth: (m,) metres along the optical axis, of the points inside.
    """

    inside: np.ndarray
    rows: np.ndarray
    cols: np.ndarray
    depth: np.ndarray


def project_into(view: View, points: np.ndarray, dtype: type[np.floating] = np.float64
                 ) -> ProjectedPoints:
    """The pixels of a pinhole view that (n, 3) world points, metres, fall into.

    Args:
        view: whose pose and calibration are used; its images are not.
        points: world frame, metres.
        dtype: of the pose; float32 with float32 points takes half the time.
    """
    k = view.intrinsics
    T_camera_world = inverse(view.T_world_camera).astype(dtype)
    pixels, z = project(apply(T_camera_world, points), k)
    x, y = pixels[:, 0], pixels[:, 1]
    inside = (z > 0) & (x > -0.5) & (x < k.width - 0.5) & (y > -0.5) & (y < k.height - 0.5)
    cols, rows = np.round(pixels[inside]).astype(int).T
    return ProjectedPoints(inside, rows, cols, z[inside])


def pixel_rays(intrinsics: Intrinsics, stride: int = 1, dtype: type[np.floating] = np.float32
               ) -> np.ndarray:
    """(h, w, 3) optical-frame rays through every `stride`-th pixel, of length 1 along z."""
    x, y = np.broadcast_arrays(*_ray_slopes(intrinsics, stride, dtype))
    return np.stack([x, y, np.ones_like(x)], axis=-1)


def unproject(depth: np.ndarray, intrinsics: Intrinsics, stride: int = 1) -> np.ndarray:
    """(h, w, 3) float32 points, metres, optical frame, of every `stride`-th pixel of `depth`."""
    x, y = _ray_slopes(intrinsics, stride, np.float32)
    z = depth[::stride, ::stride]
    return np.stack([x * z, y * z, z], axis=-1)


def world_points(view: View, stride: int = 1) -> np.ndarray:
    """(h, w, 3) float32 world points, metres, of every `stride`-th pixel; NaN without depth.

    Raises:
        ViewError: reason `no_depth`.
    """
    if view.depth is None:
        raise ViewError("no_depth", "the view has no depth image; expected one")
    depth = view.depth[::stride, ::stride]
    z = np.where(depth > 0, depth, np.float32(np.nan))
    x, y = _ray_slopes(view.intrinsics, stride, np.float32)
    T = view.T_world_camera.astype(np.float32)
    # Axis by axis, each in one piece of memory: several times faster than all at once.
    points = np.empty((3, *z.shape), np.float32)
    for axis, (along_x, along_y, along_z, shift) in zip(points, T[:3]):
        np.multiply(along_x * x + (along_y * y + along_z), z, out=axis)
        axis += shift
    return np.moveaxis(points, 0, -1)


def stride_for(view: View, least: int, most_points: int) -> int:
    """Pixels from one point of a view to the next: `least`, or more for large images.

    Args:
        view: whose size is read.
        least: pixels.
        most_points: number of points that the view may give, about.
    """
    k = view.intrinsics
    return max(least, round(float(np.sqrt(k.height * k.width / most_points))))


def _ray_slopes(intrinsics: Intrinsics, stride: int, dtype: type[np.floating]
                ) -> tuple[np.ndarray, np.ndarray]:
    """Slopes x / z, (1, w), and y / z, (h, 1), of the rays through every `stride`-th pixel."""
    k = intrinsics
    u = np.arange(0, k.width, stride).astype(dtype)[None]
    v = np.arange(0, k.height, stride).astype(dtype)[:, None]
    return (u - dtype(k.cx)) / dtype(k.fx), (v - dtype(k.cy)) / dtype(k.fy)
