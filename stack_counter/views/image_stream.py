"""What makes a view of an image: partners of its time, a calibration, something new to see."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque

import cv2
import numpy as np

from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.geometry import pose_change
from stack_counter.types import Intrinsics, View

QUEUE = 30  # messages of one kind that are kept
_THUMBNAIL = (160, 120)  # pixels; the size images are compared at: shows parts, hides noise
_PATCH = (5, 5)  # of them, over which a change is averaged: one part taken away is one


class ImageStream:
    """Images to be matched with colour images by stamp."""

    def __init__(self, kind: str, tolerance_ns: int):
        """`kind` names them in errors; `tolerance_ns`: largest difference of stamps in a view."""
        self._kind = kind
        self._tolerance_ns = tolerance_ns
        self._stamps: list[int] = []
        self._images: list[np.ndarray | ViewError] = []

    def add(self, stamp_ns: int, image: np.ndarray | ViewError) -> None:
        """Adds an (h, w) image, or why it could not be decoded."""
        i = bisect_left(self._stamps, stamp_ns)
        self._stamps.insert(i, stamp_ns)
        self._images.insert(i, image)
        self._forget(len(self._stamps) - QUEUE)

    def settled(self, stamp_ns: int) -> bool:
        """Whether no image nearer to the stamp can still come: streams are in order."""
        return bool(self._stamps) and self._stamps[-1] >= stamp_ns

    def partner(self, color: np.ndarray, stamp_ns: int, reason: str) -> np.ndarray:
        """The image nearest in time to a colour image (h, w, 3).

        Raises:
            ViewError: `unsynchronised`; the given reason if its size differs; or its own fault.
        """
        i = min(range(len(self._stamps)), key=lambda j: abs(self._stamps[j] - stamp_ns),
                default=-1)
        if i < 0 or abs(self._stamps[i] - stamp_ns) > self._tolerance_ns:
            seen = f"nearest {(self._stamps[i] - stamp_ns) / 1e6:+.1f} ms" if i >= 0 else "none"
            raise ViewError("unsynchronised", f"{self._kind} for colour at {stamp_ns} ns: {seen}; "
                                              f"expected within {self._tolerance_ns / 1e6:.1f} ms")
        image = self._images[i]
        if isinstance(image, ViewError):
            raise image
        if image.shape != color.shape[:2]:
            raise ViewError(reason, f"{self._kind} of {image.shape[1]}x{image.shape[0]}; expected "
                                    f"{color.shape[1]}x{color.shape[0]} as the colour")
        return image

    def passed(self, stamp_ns: int) -> None:
        """Forgets what no colour image after the stamp can use."""
        self._forget(bisect_left(self._stamps, stamp_ns - self._tolerance_ns))

    def restart(self, stamp_ns: int) -> None:
        """Forgets what is later than the stamp: the clock was set back."""
        later = bisect_left(self._stamps, stamp_ns + self._tolerance_ns + 1)
        del self._stamps[later:], self._images[later:]

    def _forget(self, count: int) -> None:
        if count > 0:
            del self._stamps[:count], self._images[:count]


class Calibrations:
    """Camera calibrations over time, whether sent with every image, seldom or once."""

    def __init__(self, tolerance_ns: int):
        self._tolerance_ns = tolerance_ns
        self._changes: deque[tuple[int, Intrinsics]] = deque(maxlen=QUEUE)
        self._newest_ns = 0
        self._passed_ns = 0

    def add(self, stamp_ns: int, intrinsics: Intrinsics) -> None:
        """Adds a calibration; it holds from its stamp on, the first one always."""
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if not self._changes or self._changes[-1][1] != intrinsics:
            self._changes.append((stamp_ns, intrinsics))

    def settled(self, stamp_ns: int) -> bool:
        """Whether a calibration is there, and one sent with this very image would have come.

        If none came with the last image passed, they are sent seldom or once.
        """
        with_images = self._newest_ns >= self._passed_ns - self._tolerance_ns
        return bool(self._changes) and (
            not with_images or self._newest_ns >= stamp_ns - self._tolerance_ns)

    def at(self, stamp_ns: int) -> Intrinsics | None:
        """The calibration of the image with this stamp; None if there is none at all."""
        limit = stamp_ns + self._tolerance_ns
        first = self._changes[0][1] if self._changes else None
        return next((k for t, k in reversed(self._changes) if t <= limit), first)

    def restart(self) -> None:
        """The clock was set back: the last calibration holds from now on."""
        self._changes = deque(((0, self._changes[-1][1]),) if self._changes else (), maxlen=QUEUE)
        self._newest_ns = self._passed_ns = 0

    def passed(self, stamp_ns: int) -> None:
        """Notes that the image of this stamp is decided."""
        self._passed_ns = stamp_ns

    def __bool__(self) -> bool:
        return bool(self._changes)


class ViewGate:
    """Lets views pass that are sharp and show something new since the last that passed."""

    def __init__(self, config: CollectorConfig):
        self._config = config
        self._last: tuple[np.ndarray, np.ndarray] | None = None  # pose and small grey image

    def adjust(self, config: CollectorConfig) -> None:
        """Takes over other limits."""
        self._config = config

    def check(self, view: View) -> None:
        """Refuses a view, or remembers it as the last that passed.

        Raises:
            ViewError: reason `blurred` or `duplicate`.
        """
        assert view.color is not None  # for the type checker
        grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
        sharpness = float(cv2.Laplacian(grey, cv2.CV_32F).var())
        if sharpness < self._config.min_sharpness:
            raise ViewError("blurred", f"variance of the Laplacian {sharpness:.2f}; expected at "
                                       f"least {self._config.min_sharpness}")
        small = cv2.resize(grey, _THUMBNAIL, interpolation=cv2.INTER_AREA).astype(np.float32)
        if self._last and view.fixed:
            patches = cv2.blur(np.abs(small - self._last[1]), _PATCH)
            self._check_change(float(patches.max()))
        elif self._last:
            self._check_motion(*pose_change(self._last[0], view.T_world_camera))
        self._last = (view.T_world_camera, small)

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
