# SPDX-License-Identifier: Apache-2.0
"""SE(3), projection and rectification in numpy; `T_a_b` maps points of b into a (REP-103)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import rotations
from stack_counter.errors import ScanError, ViewError
from stack_counter.types import UNSEEN, Intrinsics, View

# Models of `sensor_msgs/CameraInfo`. Drivers call by any of the first names 4, 5, 8 (rational),
# 12 (thin prism) or 14 coefficients: all that are there count, as in OpenCV.
_POLYNOMIAL = ("", "none", "plumb_bob", "rational_polynomial", "thin_prism")
_FISHEYE = ("equidistant", "fisheye")


@dataclass(frozen=True)
class GeometrySettings:
    """Which inputs are refused, and how poses are rounded; all values are chosen.

    Attributes:
        quaternion_norm_error: largest distance of a quaternion's norm from 1.
        ray_condition: largest condition number of the equations for the point nearest to several
            rays; it is about 1e6 for rays within a thousandth of a radian.
        quaternion_step: step to which the ratios of a quaternion's components to the largest are
            rounded; a hundred times the rounding errors of the way to a matrix and back.
    """

    quaternion_norm_error: float = 0.01
    ray_condition: float = 1e6
    quaternion_step: float = 2.0**-44


SETTINGS = GeometrySettings()


def pose(rotation: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(4, 4) transform from a (3, 3) rotation and a (3,) translation in metres."""
    T = np.eye(4)
    T[:3, :3] = rotation
    T[:3, 3] = translation
    return T


def inverse(T: np.ndarray) -> np.ndarray:
    """Inverse of a rigid (4, 4) transform."""
    return pose(T[:3, :3].T, -T[:3, :3].T @ T[:3, 3])


def apply(T: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(..., 3) points mapped by a (4, 4) transform."""
    return points @ T[:3, :3].T + T[:3, 3]


def pose_from_quaternion(quaternion: np.ndarray, translation: np.ndarray) -> np.ndarray:
    """(4, 4) transform from a quaternion (x, y, z, w) and a translation in metres.

    The rotation is rounded, by less than 1e-13 rad, to one that survives `quaternion_from_pose`
    and this function bit by bit.

    Raises:
        ViewError: reason `bad_pose`, for values that are not finite or a norm off 1 by over 1%.
    """
    q, t = np.asarray(quaternion, float), np.asarray(translation, float)
    norm_error = abs(float(np.linalg.norm(q)) - 1)
    if not (np.isfinite(q).all() and np.isfinite(t).all()
            and norm_error < SETTINGS.quaternion_norm_error):
        raise ViewError("bad_pose", f"quaternion {q.tolist()} with translation {t.tolist()}; "
                                    "expected finite numbers and a norm of 1")
    steps = np.round(q / q[np.argmax(np.abs(q))] / SETTINGS.quaternion_step)
    return pose(rotations.matrix_from_quaternion(steps * SETTINGS.quaternion_step), t)


def canonical_pose(T: np.ndarray) -> np.ndarray:
    """Returns the (4, 4) transform that every quaternion message of `T` is read back as.

    Rounding errors of a message grow: matching pictures amplifies a pose's 1e-16 to a thousandth
    of V. A view whose pose is canonical gives the same bits on either side of any message.
    """
    return pose_from_quaternion(quaternion_from_pose(T), T[:3, 3])


def quaternion_from_pose(T: np.ndarray) -> np.ndarray:
    """(4,) quaternion (x, y, z, w), w >= 0, of the rotation of a (4, 4) transform."""
    return rotations.quaternion_from_matrix(T[:3, :3])


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray = np.array([0.0, 0, 1])
            ) -> np.ndarray:
    """T_world_camera of a camera at `eye` whose optical axis (z) meets `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    if np.linalg.norm(right) < 1e-6:  # straight up or down: image x along world x
        right = np.array([1.0, 0, 0])
    right = right / np.linalg.norm(right)
    return pose(np.stack([right, np.cross(forward, right), forward], axis=1), eye)


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


def nearest_point_to_rays(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """(3,) point with the least sum of squared distances to n straight lines, metres.

    Args:
        origins: (n, 3) a point of each line, metres.
        directions: (n, 3) unit vectors along them.

    Raises:
        ScanError: the lines are nearly parallel.
    """
    across = [np.eye(3) - np.outer(d, d) for d in directions]
    normal = np.sum(across, axis=0)
    if np.linalg.cond(normal) > SETTINGS.ray_condition:
        raise ScanError("the views look along one direction; expected views from several sides")
    return np.linalg.solve(normal, np.sum([a @ o for a, o in zip(across, origins)], axis=0))


def interpolate_pose(T_a: np.ndarray, T_b: np.ndarray, share: float) -> np.ndarray:
    """The pose at `share` (0 to 1) of the way from one to the other: slerp and a straight line."""
    rotation = rotations.interpolate_rotation(T_a[:3, :3], T_b[:3, :3], share)
    return pose(rotation, (1 - share) * T_a[:3, 3] + share * T_b[:3, 3])


def pose_change(T_a: np.ndarray, T_b: np.ndarray) -> tuple[float, float]:
    """The distance, metres, and the angle, radians, between two poses, (4, 4) each."""
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    return (float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])),
            float(np.arccos(np.clip(cosine, -1, 1))))


def check_intrinsics(intrinsics: Intrinsics) -> None:
    """Refuses a calibration that cannot be one.

    Raises:
        ViewError: reason `bad_intrinsics`.
    """
    k = intrinsics
    values = np.array([k.fx, k.fy, k.cx, k.cy, *k.distortion], float)
    if not np.isfinite(values).all() or k.fx <= 0 or k.fy <= 0:
        raise ViewError("bad_intrinsics", f"fx {k.fx}, fy {k.fy}, cx {k.cx}, cy {k.cy}; "
                                          "expected finite numbers, fx and fy above 0: calibrate")
    if k.width <= 0 or k.height <= 0:
        raise ViewError("bad_intrinsics", f"image size {k.width}x{k.height}; expected above 0")
    if k.distortion_model not in (*_POLYNOMIAL, *_FISHEYE):
        raise ViewError("bad_intrinsics", f"distortion model '{k.distortion_model}'; expected "
                                          f"one of {[*_POLYNOMIAL[2:], *_FISHEYE]}: calibrate")
    most = 4 if k.distortion_model in _FISHEYE else 14
    if np.any(k.distortion[most:]):
        raise ViewError("bad_intrinsics", f"{len(k.distortion)} coefficients of "
                                          f"'{k.distortion_model}'; expected {most} at most")


def rectify(view: View) -> View:
    """The view as a distortion-free pinhole camera of the same K and size would have taken it.

    Depth and labels are resampled without mixing neighbours.

    Raises:
        ViewError: reason `bad_intrinsics`.
    """
    k = view.intrinsics
    check_intrinsics(k)
    # Nothing to resample where all coefficients are zero.
    pinhole = replace(k, distortion_model="", distortion=())
    if not np.any(k.distortion):
        return replace(view, intrinsics=pinhole)
    # Where each pixel of the pinhole image lies in the distorted one.
    is_fisheye = k.distortion_model in _FISHEYE
    undistort, count = (cv2.fisheye, 4) if is_fisheye else (cv2, 14)
    coefficients = np.array([*k.distortion, *[0.0] * count][:count])
    maps = undistort.initUndistortRectifyMap(k.K, coefficients, np.eye(3), k.K,
                                             (k.width, k.height), cv2.CV_32FC1)

    def remap(image: np.ndarray | None, interpolation: int, outside: int = 0
              ) -> np.ndarray | None:
        if image is None:
            return None
        return cv2.remap(image, maps[0], maps[1], interpolation, borderMode=cv2.BORDER_CONSTANT,
                         borderValue=outside)

    return replace(view, intrinsics=pinhole, color=remap(view.color, cv2.INTER_LINEAR),
                   depth=remap(view.depth, cv2.INTER_NEAREST),
                   labels=remap(view.labels, cv2.INTER_NEAREST, UNSEEN))


def crop(view: View, first: np.ndarray, last: np.ndarray) -> View:
    """Crops a pinhole view to what lies between two pixels.

    Args:
        view: without distortion.
        first: (2,) pixel (x, y) of the corner with the smallest coordinates.
        last: (2,) pixel (x, y) of the opposite one; both are moved to the image if outside.

    Raises:
        ViewError: reason `out_of_sight`, if nothing is left.
    """
    k = view.intrinsics
    size = np.array([k.width, k.height])
    # To the image while they are floats: no whole number is as large as some pixel far outside.
    low, high = np.clip(np.floor(first), 0, size), np.clip(np.ceil(last), -1, size - 1)
    if np.isnan([low, high]).any() or (high < low).any():
        raise ViewError("out_of_sight", f"pixels {first} to {last} of a {k.width}x{k.height} "
                                        "image; expected some inside")

    (x0, y0), (x1, y1) = low.astype(int), high.astype(int) + 1

    def cropped(image: np.ndarray | None) -> np.ndarray | None:
        return None if image is None else np.ascontiguousarray(image[y0:y1, x0:x1])

    # The principal point moves with the first pixel.
    intrinsics = replace(k, width=int(x1 - x0), height=int(y1 - y0), cx=k.cx - float(x0),
                         cy=k.cy - float(y0))
    return replace(view, intrinsics=intrinsics, color=cropped(view.color),
                   depth=cropped(view.depth), labels=cropped(view.labels))
