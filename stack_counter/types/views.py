# SPDX-License-Identifier: Apache-2.0
"""Cameras and their images: calibration, posed views, their tally."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

BACKGROUND, CONTAINER, PARTS = 0, 1, 2  # the values of a label image
# Pixels that count for nothing: the camera has not seen them, as at the edge of a rectified image,
# or a mask leaves them out. No value of a black-and-white mask, which is no label image.
UNSEEN = 254
UNLABELLED = 253  # pixels whose label prompts will give; of a view whose other pixels are UNSEEN


@dataclass(frozen=True)
class Intrinsics:
    """Camera calibration, as in `sensor_msgs/CameraInfo`.

    Attributes:
        width, height: image size, pixels.
        fx, fy, cx, cy: pinhole parameters, pixels; pixel centres lie on whole numbers.
        distortion_model: `plumb_bob`, `rational_polynomial`, `thin_prism`, `equidistant`,
            `fisheye` (the same), or "" for none.
        distortion: coefficients in OpenCV's order; empty or all zero for none.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float
    distortion_model: str = ""
    distortion: tuple[float, ...] = ()

    @property
    def K(self) -> np.ndarray:
        """(3, 3) float64 camera matrix, pixels."""
        return np.array([[self.fx, 0, self.cx], [0, self.fy, self.cy], [0, 0, 1]], float)


@dataclass(frozen=True, eq=False)
class View:
    """One posed image.

    Attributes:
        stamp_ns: time of exposure, ns.
        intrinsics: calibration of all the images below.
        T_world_camera: (4, 4) float64, camera in its optical frame (x right, y down, z forward).
        color: (h, w, 3) uint8 RGB, or None.
        depth: (h, w) float32, metres along optical z, 0 where invalid, or None.
        labels: (h, w) uint8 label image (0 background, 1 container, 2 parts, 253 not labelled yet,
            254 not seen or masked out), or None.
        camera: name of the optical frame.
        fixed: the camera cannot move (its pose comes from static transforms alone).
    """

    stamp_ns: int
    intrinsics: Intrinsics
    T_world_camera: np.ndarray
    color: np.ndarray | None = None
    depth: np.ndarray | None = None
    labels: np.ndarray | None = None
    camera: str = ""
    fixed: bool = False


@dataclass(frozen=True, eq=False)
class KeyView:
    """The view that shows the most parts, cropped to them (paper, section 3.2).

    Attributes:
        stamp_ns: of the view.
        intrinsics: of the crop (principal point shifted), no distortion.
        T_world_camera: (4, 4) float64.
        part_pixels: number of pixels labelled parts.
        labels: (h, w) uint8 label image of the crop.
        depth: (h, w) float32 metres of the crop, 0 where invalid; None without depth.
        color: (h, w, 3) uint8 RGB of the crop, or None.
    """

    stamp_ns: int
    intrinsics: Intrinsics
    T_world_camera: np.ndarray
    part_pixels: int
    labels: np.ndarray
    depth: np.ndarray | None = None
    color: np.ndarray | None = None


@dataclass(frozen=True)
class ViewTally:
    """How many views came, were used, and were skipped for which reason."""

    received: int = 0
    used: int = 0
    skipped: dict[str, int] = field(default_factory=dict)

    def __add__(self, later: ViewTally) -> ViewTally:
        """The tally of two stages in a row: what the first passed on, the second received."""
        return ViewTally(self.received, later.used,
                         dict(Counter(self.skipped) + Counter(later.skipped)))


def spread_views(views: Sequence[View], most: int) -> list[View]:
    """At most so many views in their order, spread evenly over all, the first among them."""
    if not views:
        return []
    return [views[i] for i in np.unique(np.linspace(0, len(views) - 1, most).round().astype(int))]
