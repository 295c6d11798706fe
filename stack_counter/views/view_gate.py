# SPDX-License-Identifier: Apache-2.0
"""Which views are worth keeping: sharp ones that show something new."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import View
from stack_counter.views.scene_change import (
    Thumbnail,
    depth_change,
    make_thumbnail,
    picture_change,
)


@dataclass(frozen=True)
class ViewGateSettings:
    """Which place is the same, and when depth shows something new where the picture does not.

    Attributes:
        same_place_m: a camera that stands, or was brought back, is at most so far from where it
            was, as its pose says, metres: three times an arm's noise; chosen.
        same_place_rad: and turned by at most so much, radians; chosen.
        moved_margin: a camera that is that far off must see so many times the change of one that
            stands, as a motion does not explain all that it changes; measured as the next.
        min_depth_change_per_m: change of depth of some place over the depth squared, 1/m: 3 mm at
            0.5 m; six times what noise alone makes of it, see `SceneChangeSettings`.
    """

    same_place_m: float = 0.002
    same_place_rad: float = 0.004
    moved_margin: float = 3.0
    min_depth_change_per_m: float = 0.012


SETTINGS = ViewGateSettings()


class ViewGate:
    """Accepts views that are sharp and show something new since the last one accepted.

    A view from another place is new. At the same place, picture or depth must have changed by
    more than the camera's small motion explains. In between a moving camera is on its way to the
    next view of a scan; a scan that never ends takes such a view like one from the same place.
    """

    def __init__(self, config: CollectorConfig):
        """Accepts the first sharp view. `config`: `min_*` settings."""
        self._config = config
        self._last: Thumbnail | None = None

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
        # The camera must have moved, or see a change.
        thumbnail = make_thumbnail(view, grey)
        if self._last is not None:
            motion = (0.0, 0.0) if view.fixed else geometry.pose_change(
                self._last.T_world_camera, view.T_world_camera)
            self._check_news(self._last, thumbnail, motion)
        self._last = thumbnail

    def _check_news(self, last: Thumbnail, thumbnail: Thumbnail,
                    motion: tuple[float, float]) -> None:
        """Refuses a duplicate of the last view."""
        c, (distance, angle) = self._config, motion
        if distance >= c.min_motion_m or angle >= c.min_motion_rad:
            return
        seen = (f"moved {distance:.4f} m and {angle:.4f} rad since the last view; "
                f"expected {c.min_motion_m} or {c.min_motion_rad}")
        same_place = distance <= SETTINGS.same_place_m and angle <= SETTINGS.same_place_rad
        if not same_place and c.mode != "continuous":
            raise ViewError("duplicate", seen)
        off = max(distance / SETTINGS.same_place_m, angle / SETTINGS.same_place_rad)
        margin = 1 + (SETTINGS.moved_margin - 1) * min(off, 1.0)
        min_change, min_depth = c.min_change * margin, SETTINGS.min_depth_change_per_m * margin
        picture = picture_change(last, thumbnail, motion)
        if picture >= min_change:
            return
        depth = depth_change(last, thumbnail, motion)
        if depth < min_depth:
            raise ViewError("duplicate", f"{seen}, or a change: {picture:.2f} of {min_change:.1f} "
                                         f"grey levels, {depth:.4f} of {min_depth:.3f} / m of "
                                         "depth")
