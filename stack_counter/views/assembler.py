"""From messages of one camera to the views of a scan; for the collector node and for replay.

What comes out depends on the data alone, not on the order in which topics arrive: a view is
decided in stamp order, and only once all that can still change it has come.
"""

from __future__ import annotations

import logging
import time
from collections import Counter, deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import View, ViewTally
from stack_counter.views import decoding
from stack_counter.views.image_stream import QUEUE, Calibrations, ImageStream, ViewGate
from stack_counter.views.tf_buffer import TransformBuffer

_LOG = logging.getLogger(__name__)
_SELDOM = 4  # images waiting, as many as replay has in flight: not each brings a calibration
_JUMP_NS = 10**9  # back by more than this is no image that is late
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

    def __init__(self, config: CollectorConfig, live: bool = True,
                 T_world_camera: np.ndarray | None = None, frame: str = ""):
        """Makes one that has seen nothing.

        Args:
            config: settings.
            live: messages that stay away are given up after `tf_timeout_s` of wall time. Replay
                without ROS has nothing to wait for; there, nothing may depend on the clock.
            T_world_camera: (4, 4) pose of a fixed camera; None: TF or a topic says it.
            frame: of the camera in TF; empty: as its images say.
        """
        self._T_world_camera, self._tf_frame = T_world_camera, frame
        self._config = config
        self._live = live
        self._tolerance_ns = round(config.sync_tolerance_s * 1e9)
        self._transforms = TransformBuffer(config.tf_max_gap_s)
        self._calibrations = Calibrations(self._tolerance_ns)
        self.start()

    def start(self) -> None:
        """A new scan: forgets images and tally, keeps transforms and calibration."""
        self._waiting: deque[_Waiting] = deque()
        self._depths = ImageStream("depth", self._tolerance_ns)
        self._labels = ImageStream("labels", self._tolerance_ns)
        self._gate = ViewGate(self._config)
        self._skipped: Counter[str] = Counter()
        self._received = self._accepted = 0
        self._newest = self._behind = -1
        self._frame = ""
        self.last_error: dict[str, str] = {}

    def adjust(self, config: CollectorConfig) -> None:
        """Takes over other gates; a node's parameters have changed."""
        self._config = config
        self._gate.adjust(config)

    @property
    def waiting(self) -> int:
        """Images that wait for their partners, calibration or pose."""
        return len(self._waiting)

    @property
    def tally(self) -> ViewTally:
        """Images received, views accepted, and skipped by reason."""
        return ViewTally(self._received, self._accepted, dict(self._skipped))

    # --- messages in --------------------------------------------------------------------------

    def add_color(self, message: Any) -> None:
        """A colour `Image` or `CompressedImage`; the one message that every view has."""
        self._received += 1
        try:
            stamp, frame = decoding.stamp_ns(message.header.stamp), message.header.frame_id
            self._check_order(stamp, frame)
            self._waiting.append(_Waiting(stamp, frame, decoding.color_to_array(message),
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
        behind, self._behind = self._behind, -1
        if -1 < behind < stamp < self._newest - _JUMP_NS:  # two in a row: the clock was set back
            self._restart(stamp)
        elif stamp < self._newest:
            self._behind = stamp
            raise ViewError("time_backwards", f"stamp {stamp} ns after {self._newest} ns; "
                                              "expected stamps that grow")
        self._newest = stamp

    def _restart(self, stamp: int) -> None:
        """The time is another one: what waits will not find its partners."""
        for _ in self._waiting:
            self._skip(ViewError("time_jumped", f"the clock went back from {self._newest} ns"))
        self._waiting.clear()
        for stream in (self._depths, self._labels):
            stream.restart(stamp)
        self._calibrations.restart()

    def add_depth(self, message: Any) -> None:
        """An aligned depth `Image`."""
        self._keep(self._depths, message, decoding.depth_to_metres)

    def add_labels(self, message: Any) -> None:
        """An aligned label `Image`."""
        self._keep(self._labels, message, decoding.labels_to_array)

    def _keep(self, stream: ImageStream, message: Any, decode: Callable[[Any], np.ndarray]
              ) -> None:
        try:
            image: np.ndarray | ViewError = decode(message)
        except ViewError as error:
            image = error  # counted when the view that needs it is decided
        stream.add(decoding.stamp_ns(message.header.stamp), image)

    def add_camera_info(self, message: Any) -> None:
        """A `CameraInfo`; checked when a view needs it."""
        self._calibrations.add(decoding.stamp_ns(message.header.stamp),
                               decoding.camera_info_to_intrinsics(message))

    def add_transform(self, message: Any, static: bool) -> None:
        """A `TransformStamped` of /tf or /tf_static; a damaged one is dropped and logged."""
        self._add_pose(message.header, message.child_frame_id, message.transform,
                       decoding.transform_to_matrix, static)

    def add_pose(self, message: Any) -> None:
        """A `PoseStamped` of the optical frame."""
        self._add_pose(message.header, _POSE_FRAME, message.pose, decoding.pose_to_matrix, False)

    def _add_pose(self, header: Any, child: str, pose: Any, decode: Any, static: bool) -> None:
        try:
            T = decode(pose)
        except ViewError as error:
            self._log(error)
            return
        self._transforms.add_transform(decoding.stamp_ns(header.stamp),
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
            late = self._live and time.monotonic() - head.since >= self._config.tf_timeout_s
            patient = not (everything or late or len(self._waiting) > QUEUE)
            if patient and not self._complete(head):
                break
            try:
                views.append(self._view(head))
                self._accepted += 1
            except ViewError as error:
                self._skip(error)
            self._waiting.popleft()
            for stream in (self._calibrations, self._depths, self._labels):
                stream.passed(head.stamp_ns)
        return views

    def _complete(self, head: _Waiting) -> bool:
        """Whether nothing that may still come can change this view."""
        # With newer images there, a calibration sent with this very one would have come.
        calibrated = self._calibrations.settled(head.stamp_ns) or (
            bool(self._calibrations) and len(self._waiting) >= _SELDOM)
        return (calibrated
                and (not self._config.depth_topic or self._depths.settled(head.stamp_ns))
                and (not self._config.labels_topic or self._labels.settled(head.stamp_ns))
                and self._located(head))

    def _located(self, head: _Waiting) -> bool:
        return self._T_world_camera is not None or self._transforms.ready(
            self._config.world_frame, self._source(head), head.stamp_ns)

    def _source(self, head: _Waiting) -> str:
        if self._config.pose_source == "topic":
            return _POSE_FRAME
        return (self._tf_frame or head.frame).lstrip("/")

    def _view(self, head: _Waiting) -> View:
        """The view of a colour image.

        Raises:
            ViewError: why it is skipped.
        """
        intrinsics = self._calibrations.at(head.stamp_ns)
        if intrinsics is None:
            raise ViewError("no_camera_info", f"no message on {self._config.camera_info_topic}; "
                                              "expected a calibration")
        geometry.check_intrinsics(intrinsics)
        size = (intrinsics.height, intrinsics.width)
        if head.color.shape[:2] != size:
            raise ViewError("size_mismatch", f"image of {head.color.shape[1]}x"
                                             f"{head.color.shape[0]}; expected {size[1]}x{size[0]}"
                                             " as in camera_info")
        depth = labels = None
        if self._config.depth_topic:
            depth = self._depths.partner(head.color, head.stamp_ns, "bad_depth")
        if self._config.labels_topic:
            labels = self._labels.partner(head.color, head.stamp_ns, "bad_labels")
        T, fixed = self._pose(head)
        view = View(head.stamp_ns, intrinsics, T, head.color, depth, labels, head.frame, fixed)
        self._gate.check(view)
        return view

    def _pose(self, head: _Waiting) -> tuple[np.ndarray, bool]:
        if self._T_world_camera is not None:
            return self._T_world_camera, True
        return self._transforms.lookup(self._config.world_frame, self._source(head), head.stamp_ns)

    def _skip(self, error: ViewError) -> None:
        self._skipped[error.reason] += 1
        self._log(error)

    def _log(self, error: ViewError) -> None:
        if error.reason not in self.last_error:  # the first of its kind; the rest are counted
            _LOG.warning("view skipped: %s", error)
        self.last_error[error.reason] = str(error)
