# SPDX-License-Identifier: Apache-2.0
"""Which views are worth keeping: sharp ones that show something new."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import View


@dataclass(frozen=True)
class ViewGateSettings:
    """How two images of a fixed camera are compared; chosen.

    Attributes:
        thumbnail_px: width and height at which images are compared, pixels: parts still show,
            noise does not.
        patch_px: size of the window over which a change is averaged, pixels of the thumbnail:
            one part that is taken away fills it.
    """

    thumbnail_px: tuple[int, int] = (160, 120)
    patch_px: tuple[int, int] = (5, 5)


SETTINGS = ViewGateSettings()


class PoseChange(NamedTuple):
    """Difference of two poses: distance in metres, angle in radians."""

    distance: float
    angle: float


def pose_change(T_a: np.ndarray, T_b: np.ndarray) -> PoseChange:
    """The distance and the angle between two poses, (4, 4) each."""
    cosine = (np.trace(T_a[:3, :3].T @ T_b[:3, :3]) - 1) / 2
    return PoseChange(distance=float(np.linalg.norm(T_a[:3, 3] - T_b[:3, 3])),
                      angle=float(np.arccos(np.clip(cosine, -1, 1))))


class ViewGate:
    """Accepts views that are sharp and show something new since the last one accepted."""

    def __init__(self, config: CollectorConfig):
        """Accepts the first sharp view. `config`: `min_*` settings."""
        self._config = config
        self._last_pose: np.ndarray | None = None
        self._last_thumbnail: np.ndarray | None = None

    def apply_limits(self, config: CollectorConfig) -> None:
        """Replaces the limits; they hold from the next view on."""
        self._config = config

    def check(self, view: View) -> None:
        """Accepts a view and remembers it as the last one.

        Raises:
            ViewError: the view is refused: `blurred`, or a `duplicate` of the last one.
        """
        # A blurred image has little variance in its second derivative.
        grey = cv2.cvtColor(np.asarray(view.color), cv2.COLOR_RGB2GRAY)
        sharpness = float(cv2.Laplacian(grey, cv2.CV_32F).var())
        if sharpness < self._config.min_sharpness:
            raise ViewError("blurred", f"variance of the Laplacian {sharpness:.2f}; expected at "
                                       f"least {self._config.min_sharpness}")
        # A fixed camera must see a change, a moving one must have moved.
        thumbnail = cv2.resize(grey, SETTINGS.thumbnail_px,
                               interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._last_thumbnail is not None and view.fixed:
            change = cv2.blur(np.abs(thumbnail - self._last_thumbnail), SETTINGS.patch_px)
            self._check_change(float(change.max()))
        elif self._last_pose is not None:
            self._check_motion(*pose_change(self._last_pose, view.T_world_camera))
        self._last_pose, self._last_thumbnail = view.T_world_camera, thumbnail

    def _check_change(self, change: float) -> None:
        if change < self._config.min_change:
            raise ViewError("duplicate", f"largest grey-level change {change:.2f} of a fixed "
                                         f"camera; expected at least {self._config.min_change}")

    def _check_motion(self, metres: float, radians: float) -> None:
        c = self._config
        if metres < c.min_motion_m and radians < c.min_motion_rad:
            raise ViewError("duplicate", f"moved {metres:.4f} m and {radians:.4f} rad since the "
                                         f"last view; expected {c.min_motion_m} or "
                                         f"{c.min_motion_rad}")
