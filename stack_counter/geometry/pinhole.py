# SPDX-License-Identifier: Apache-2.0
"""Views as pinhole cameras: calibrations that can be one, images without distortion, crops."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stack_counter.errors import ViewError
from stack_counter.types import UNSEEN, Intrinsics, View

# Models of `sensor_msgs/CameraInfo`, and what Kalibr, RealSense's SDK and simulators call them.
# Drivers call by any of the first names 4, 5, 8 (rational), 12 (thin prism) or 14 coefficients:
# all that are there count, as in OpenCV.
_POLYNOMIAL = ("plumb_bob", "rational_polynomial", "thin_prism", "radtan", "brown_conrady")
_FISHEYE = ("equidistant", "fisheye", "kannala_brandt")


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
    model = _spelled(k.distortion_model)
    # Without coefficients nothing is distorted, whatever a driver calls that.
    if np.any(k.distortion) and model not in ("", "none", *_POLYNOMIAL, *_FISHEYE):
        raise ViewError("bad_intrinsics", f"distortion model '{k.distortion_model}' with "
                                          f"coefficients {list(k.distortion)}; expected one of "
                                          f"{[*_POLYNOMIAL, *_FISHEYE]}: calibrate")
    most = 4 if model in _FISHEYE else 14
    if np.any(k.distortion[most:]):
        raise ViewError("bad_intrinsics", f"{len(k.distortion)} coefficients of "
                                          f"'{k.distortion_model}'; expected {most} at most")


def _spelled(model: str) -> str:
    """The name of a distortion model as ROS spells it: `Plumb Bob` is `plumb_bob`."""
    return model.strip().lower().replace(" ", "_").replace("-", "_")


def rectify(view: View) -> View:
    """The view as a distortion-free pinhole camera of the same K and size would have taken it.

    Depth and labels are resampled without mixing neighbours.

    Raises:
        ViewError: reason `bad_intrinsics`.
    """
    k = view.intrinsics
    check_intrinsics(k)
    # Nothing to resample where all coefficients are zero, or without an image: a message may then
    # state any size.
    pinhole = replace(k, distortion_model="", distortion=())
    if not np.any(k.distortion) or (view.color is view.depth is view.labels is None):
        return replace(view, intrinsics=pinhole)
    # Where each pixel of the pinhole image lies in the distorted one.
    is_fisheye = _spelled(k.distortion_model) in _FISHEYE
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
