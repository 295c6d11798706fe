# SPDX-License-Identifier: Apache-2.0
"""Images and calibrations that are matched with colour images by their stamps."""

from __future__ import annotations

from bisect import bisect_left
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.types import Intrinsics
from stack_counter.views import decoding

MAX_QUEUED_MESSAGES = 30


@dataclass(frozen=True, eq=False)
class WaitingImage:
    """A colour image that waits for depth, labels, calibration and pose.

    Attributes:
        stamp_ns: its stamp, ns.
        frame: name of its optical frame.
        color: (h, w, 3) uint8 RGB.
        since: time of `awake_time` at its arrival, seconds.
    """

    stamp_ns: int
    frame: str
    color: np.ndarray
    since: float


class ImageStream:
    """Depth or label images of one camera, in the order of their stamps."""

    def __init__(self, kind: str, tolerance_ns: int):
        """Makes an empty stream.

        Args:
            kind: names the images in errors.
            tolerance_ns: largest difference of the stamps of one view's images, ns.
        """
        self._kind = kind
        self._tolerance_ns = tolerance_ns
        self._stamps: list[int] = []
        self._images: list[tuple[str, np.ndarray | ViewError]] = []

    def add(self, stamp_ns: int, image: np.ndarray | ViewError, frame: str = "") -> None:
        """Adds an (h, w) image of a camera frame, or the error that says why there is none."""
        i = bisect_left(self._stamps, stamp_ns)
        self._stamps.insert(i, stamp_ns)
        self._images.insert(i, (frame, image))
        self._forget(len(self._stamps) - MAX_QUEUED_MESSAGES)

    def add_message(self, message: Any, decode: Callable[[Any], np.ndarray], topic: str) -> None:
        """Adds the image of a topic's message; an error of it is raised where it is needed."""
        try:
            image: np.ndarray | ViewError = decode(message)
        except ViewError as error:
            image = error.on(topic)
        self.add(decoding.stamp_ns(message.header.stamp), image,
                 message.header.frame_id.lstrip("/"))

    def is_settled(self, stamp_ns: int) -> bool:
        """Tells whether no image nearer to the stamp can still come: streams are in order."""
        return bool(self._stamps) and self._stamps[-1] >= stamp_ns

    def nearest(self, stamp_ns: int) -> tuple[str, np.ndarray]:
        """Returns the image nearest in time to a colour image, and its camera frame.

        Raises:
            ViewError: no image is near enough (`unsynchronised`), or the nearest one could not be
                decoded (its own reason).
        """
        i = min(range(len(self._stamps)), key=lambda j: abs(self._stamps[j] - stamp_ns),
                default=-1)
        if i < 0 or abs(self._stamps[i] - stamp_ns) > self._tolerance_ns:
            seen = f"nearest {(self._stamps[i] - stamp_ns) / 1e6:+.1f} ms" if i >= 0 else "none"
            raise ViewError("unsynchronised", f"{self._kind} for colour at {stamp_ns} ns: {seen}; "
                                              f"expected within {self._tolerance_ns / 1e6:.1f} ms "
                                              "(sync_tolerance_s)")
        frame, image = self._images[i]
        if isinstance(image, ViewError):
            raise image
        return frame, image

    def nearest_image(self, color: np.ndarray, stamp_ns: int, reason: str) -> np.ndarray:
        """Returns the image nearest in time to a colour image, of its size.

        Args:
            color: (h, w, 3) colour image.
            stamp_ns: its stamp, ns.
            reason: reason of the error if the sizes differ.

        Raises:
            ViewError: no image is near enough (`unsynchronised`), the nearest one has another size
                (`reason`), or could not be decoded (its own reason).
        """
        _, image = self.nearest(stamp_ns)
        if image.shape != color.shape[:2]:
            raise ViewError(reason, f"{self._kind} of {image.shape[1]}x{image.shape[0]}; expected "
                                    f"{color.shape[1]}x{color.shape[0]} as the colour: set "
                                    f"{self._kind}_topic to a stream aligned to it")
        return image

    def forget_before(self, stamp_ns: int) -> None:
        """Forgets the images that no colour image after the stamp can use."""
        self._forget(bisect_left(self._stamps, stamp_ns - self._tolerance_ns))

    def restart(self, stamp_ns: int) -> None:
        """Forgets the images later than the stamp, since the clock was set back to it."""
        later = bisect_left(self._stamps, stamp_ns + self._tolerance_ns + 1)
        del self._stamps[later:], self._images[later:]

    def _forget(self, count: int) -> None:
        if count > 0:
            del self._stamps[:count], self._images[:count]


class Calibrations:
    """Camera calibrations over time, whether sent with every image, seldom or once."""

    def __init__(self, tolerance_ns: int):
        """Makes one without calibrations. `tolerance_ns` is that of the images' stamps, ns."""
        self._tolerance_ns = tolerance_ns
        self._changes: deque[tuple[int, Intrinsics]] = deque(maxlen=MAX_QUEUED_MESSAGES)
        self._newest_ns = 0
        self._passed_ns = 0

    def add(self, stamp_ns: int, intrinsics: Intrinsics) -> None:
        """Adds a calibration; it holds from its stamp on, the first one always."""
        self._newest_ns = max(self._newest_ns, stamp_ns)
        if not self._changes or self._changes[-1][1] != intrinsics:
            self._changes.append((stamp_ns, intrinsics))

    def is_settled(self, stamp_ns: int) -> bool:
        """Tells whether there is a calibration that no later message can change for this image.

        A calibration sent with this very image would have come. If none came with the last image
        decided, calibrations are sent seldom or once.
        """
        with_images = self._newest_ns >= self._passed_ns - self._tolerance_ns
        return bool(self._changes) and (
            not with_images or self._newest_ns >= stamp_ns - self._tolerance_ns)

    def calibration_at(self, stamp_ns: int) -> Intrinsics | None:
        """Returns the calibration of the image with this stamp; None if there is none at all."""
        limit = stamp_ns + self._tolerance_ns
        first = self._changes[0][1] if self._changes else None
        return next((k for t, k in reversed(self._changes) if t <= limit), first)

    def calibration_of(self, color: np.ndarray, stamp_ns: int, topic: str) -> Intrinsics:
        """Returns the calibration of an (h, w, 3) colour image; `topic` names it in errors.

        Raises:
            ViewError: there is none (`no_camera_info`), it cannot be one (`bad_intrinsics`) or is
                of another size (`size_mismatch`).
        """
        intrinsics = self.calibration_at(stamp_ns)
        if intrinsics is None:
            raise ViewError("no_camera_info", f"no message on {topic}; expected a calibration: "
                                              "set camera_info_topic, or start and record it")
        geometry.check_intrinsics(intrinsics)
        width, height = intrinsics.width, intrinsics.height
        if color.shape[:2] != (height, width):
            raise ViewError("size_mismatch", f"image of {color.shape[1]}x{color.shape[0]}; "
                                             f"expected {width}x{height} as in camera_info: set "
                                             "camera_info_topic to the one of this stream")
        return intrinsics

    def restart(self) -> None:
        """Keeps the last calibration from now on, since the clock was set back."""
        self._changes = deque(
            ((0, self._changes[-1][1]),) if self._changes else (), maxlen=MAX_QUEUED_MESSAGES
        )
        self._newest_ns = self._passed_ns = 0

    def note_decided(self, stamp_ns: int) -> None:
        """Notes that the image of this stamp is accepted or skipped."""
        self._passed_ns = stamp_ns

    def __bool__(self) -> bool:
        """Tells whether there is any calibration."""
        return bool(self._changes)
