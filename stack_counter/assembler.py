"""From messages of one camera to the views of a scan; for the collector node and for replay.

What comes out depends on the data alone, not on the order in which topics arrive: a view is
decided in stamp order, and only once all that can still change it has come.
"""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from stack_counter import geometry, messages
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.transforms import TransformBuffer
from stack_counter.types import Intrinsics, View, ViewTally

_LOG = logging.getLogger(__name__)
_QUEUE = 30  # images of a kind that wait for their partners
_POSE_FRAME = "pose topic"  # name, in the buffer, of the frame whose pose a topic gives


@dataclass(frozen=True)
class _Waiting:
    """A colour image that waits for depth, labels, calibration and pose."""

    stamp_ns: int
    frame: str
    color: np.ndarray
    since: float  # wall clock, s


class ViewAssembler:
    """Matches images by stamp, finds their poses, and skips what is not worth a view."""

    def __init__(self, config: CollectorConfig):
        self._config = config
        self._tolerance_ns = round(config.sync_tolerance_s * 1e9)
        self._transforms = TransformBuffer(config.tf_max_gap_s)
        self._infos: dict[int, Intrinsics] = {}  # by stamp, oldest first
        self.start()

    def start(self) -> None:
        """A new scan: forgets images and tally, keeps transforms and calibration."""
        self._waiting: deque[_Waiting] = deque()
        # A message that does not decode keeps its error until its view is decided.
        self._depths: dict[int, np.ndarray | ViewError] = {}
        self._labels: dict[int, np.ndarray | ViewError] = {}
        self._skipped: Counter[str] = Counter()
        self._received = self._accepted = 0
        self._last: View | None = None  # last view accepted
        self._newest = -1
        self._frame = ""
        self.last_error: dict[str, str] = {}

    @property
    def tally(self) -> ViewTally:
        """Images received, views accepted, and skipped by reason."""
        return ViewTally(self._received, self._accepted, dict(self._skipped))

    # --- messages in --------------------------------------------------------------------------

    def add_color(self, message: Any) -> None:
        """A colour `Image` or `CompressedImage`; the one message that every view has."""
        self._received += 1
        try:
            stamp, frame = messages.stamp_ns(message.header.stamp), message.header.frame_id
            self._check_order(stamp, frame)
            self._waiting.append(_Waiting(stamp, frame, messages.color_to_array(message),
                                          time.monotonic()))
        except ViewError as error:
            self._skip(error)

    def _check_order(self, stamp: int, frame: str) -> None:
        self._frame = self._frame or frame
        if frame != self._frame:
            raise ViewError("frame_changed", f"image of '{frame}'; expected '{self._frame}' only: "
                                             "two cameras speak on one topic")
        if stamp == self._newest:
            raise ViewError("duplicate", f"a second image with stamp {stamp} ns")
        if stamp < self._newest:
            raise ViewError("time_backwards", f"stamp {stamp} ns after {self._newest} ns; "
                                              "expected stamps that grow")
        self._newest = stamp

    def add_depth(self, message: Any) -> None:
        """An aligned depth `Image`."""
        self._keep(self._depths, message, messages.depth_to_metres)

    def add_labels(self, message: Any) -> None:
        """An aligned label `Image`."""
        self._keep(self._labels, message, messages.labels_to_array)

    def _keep(self, images: dict[int, np.ndarray | ViewError], message: Any, decode: Any) -> None:
        try:
            image: np.ndarray | ViewError = decode(message)
        except ViewError as error:
            image = error
        images[messages.stamp_ns(message.header.stamp)] = image
        if len(images) > _QUEUE:
            del images[min(images)]

    def add_camera_info(self, message: Any) -> None:
        """A `CameraInfo`; checked when a view needs it."""
        stamp = messages.stamp_ns(message.header.stamp)
        self._infos.pop(stamp, None)
        self._infos[stamp] = messages.camera_info_to_intrinsics(message)
        if len(self._infos) > _QUEUE:
            del self._infos[next(iter(self._infos))]

    def add_transform(self, message: Any, static: bool) -> None:
        """A `TransformStamped` of /tf or /tf_static; a damaged one is dropped and logged."""
        self._add_pose(message.header, message.child_frame_id, message.transform,
                       messages.transform_to_matrix, static)

    def add_pose(self, message: Any) -> None:
        """A `PoseStamped` of the optical frame."""
        self._add_pose(message.header, _POSE_FRAME, message.pose, messages.pose_to_matrix, False)

    def _add_pose(self, header: Any, child: str, pose: Any, decode: Any, static: bool) -> None:
        try:
            T = decode(pose)
        except ViewError as error:
            self._log(error)
            return
        self._transforms.add_transform(messages.stamp_ns(header.stamp),
                                       header.frame_id.lstrip("/"), child.lstrip("/"), T, static)

    # --- views out ----------------------------------------------------------------------------

    def poll(self) -> list[View]:
        """The views that are complete now, in stamp order."""
        return self._decide(everything=False)

    def flush(self) -> list[View]:
        """The end of a scan or bag: decides all that wait."""
        return self._decide(everything=True)

    def _decide(self, everything: bool) -> list[View]:
        views = []
        while self._waiting:
            head = self._waiting[0]
            patient = not everything and len(self._waiting) <= _QUEUE \
                and time.monotonic() - head.since < self._config.tf_timeout_s
            if patient and not self._complete(head):
                break
            self._waiting.popleft()
            try:
                view = self._view(head)
            except ViewError as error:
                self._skip(error)
                continue
            self._accepted += 1
            self._last = view
            views.append(view)
        return views

    def _complete(self, head: _Waiting) -> bool:
        """Whether nothing that may still come can change this view."""
        def settled(images: dict[int, Any]) -> bool:
            return self._match(images, head.stamp_ns) is not None \
                or (bool(images) and max(images) > head.stamp_ns + self._tolerance_ns)

        return (bool(self._infos)
                and (not self._config.depth_topic or settled(self._depths))
                and (not self._config.labels_topic or settled(self._labels))
                and self._transforms.ready(self._config.world_frame, self._source(head),
                                           head.stamp_ns))

    def _source(self, head: _Waiting) -> str:
        return _POSE_FRAME if self._config.pose_source == "topic" else head.frame.lstrip("/")

    def _match(self, images: dict[int, Any], stamp: int) -> int | None:
        """Stamp of the image closest to `stamp`, if within the tolerance."""
        nearest = min(images, key=lambda other: abs(other - stamp), default=None)
        return nearest if nearest is not None and abs(nearest - stamp) <= self._tolerance_ns \
            else None

    def _view(self, head: _Waiting) -> View:
        """The view, or why it is skipped."""
        if not self._infos:
            raise ViewError("no_camera_info", f"no message on {self._config.camera_info_topic}; "
                                              "expected a calibration")
        intrinsics = self._infos.get(head.stamp_ns) or next(reversed(self._infos.values()))
        geometry.check_intrinsics(intrinsics)
        size = (intrinsics.height, intrinsics.width)
        if head.color.shape[:2] != size:
            raise ViewError("size_mismatch", f"image of {head.color.shape[1]}x"
                                             f"{head.color.shape[0]}; expected {size[1]}x{size[0]}"
                                             " as in camera_info")
        depth = labels = None
        if self._config.depth_topic:
            depth = self._partner(self._depths, head, "bad_depth", "depth")
        if self._config.labels_topic:
            labels = self._partner(self._labels, head, "bad_labels", "labels")
        T, fixed = self._transforms.lookup(self._config.world_frame, self._source(head),
                                           head.stamp_ns)
        view = View(head.stamp_ns, intrinsics, T, head.color, depth, labels, head.frame, fixed)
        self._check_worth(view)
        return view

    def _partner(self, images: dict[int, np.ndarray | ViewError], head: _Waiting, reason: str,
                 name: str) -> np.ndarray:
        stamp = self._match(images, head.stamp_ns)
        if stamp is None:
            raise ViewError("unsynchronised", f"no {name} within {self._config.sync_tolerance_s} s"
                                              f" of stamp {head.stamp_ns} ns; expected one")
        image = images[stamp]
        if isinstance(image, ViewError):
            raise image
        if image.shape != head.color.shape[:2]:
            raise ViewError(reason, f"{name} of {image.shape[1]}x{image.shape[0]}; expected "
                                    f"{head.color.shape[1]}x{head.color.shape[0]} as the colour")
        return image

    def _check_worth(self, view: View) -> None:
        """Blurred images and images that show nothing new are no views."""
        c = self._config
        grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
        sharpness = float(cv2.Laplacian(grey, cv2.CV_32F).var())
        if sharpness < c.min_sharpness:
            raise ViewError("blurred", f"variance of the Laplacian {sharpness:.2f}; expected at "
                                       f"least {c.min_sharpness}")
        last = self._last
        if last is None:
            return
        if view.fixed:
            change = float(cv2.absdiff(view.color, last.color).mean())
            if change < c.min_change:
                raise ViewError("duplicate", f"mean grey-level change {change:.2f} of a fixed "
                                             f"camera; expected at least {c.min_change}")
            return
        metres, radians = geometry.pose_change(last.T_world_camera, view.T_world_camera)
        if metres < c.min_motion_m and radians < c.min_motion_rad:
            raise ViewError("duplicate", f"moved {metres:.4f} m and {radians:.4f} rad since the "
                                         f"last view; expected {c.min_motion_m} or "
                                         f"{c.min_motion_rad}")

    def _skip(self, error: ViewError) -> None:
        self._skipped[error.reason] += 1
        self._log(error)

    def _log(self, error: ViewError) -> None:
        if error.reason not in self.last_error:  # the first of its kind; the rest are counted
            _LOG.warning("view skipped: %s", error)
        self.last_error[error.reason] = str(error)
