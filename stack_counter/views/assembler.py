# SPDX-License-Identifier: Apache-2.0
"""Messages of one camera become the views of a scan, in the collector node and in replay.

The views depend on the data alone, not on the order in which topics arrive: a view is
decided in stamp order, and only once all that can still change it has come.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import View, ViewTally
from stack_counter.views import decoding
from stack_counter.views.awake_clock import awake_time
from stack_counter.views.camera_search import is_rectified
from stack_counter.views.depth_stream import DepthStream
from stack_counter.views.image_stream import (
    MAX_QUEUED_MESSAGES,
    Calibrations,
    ImageStream,
    WaitingImage,
)
from stack_counter.views.robot import Robot
from stack_counter.views.tf_buffer import TransformBuffer
from stack_counter.views.view_gate import ViewGate

_LOG = logging.getLogger(__name__)
# Name, in the transform buffer, of the frame whose pose a topic gives.
_POSE_TOPIC_FRAME = "pose topic"


@dataclass(frozen=True)
class AssemblerSettings:
    """What the stamps of a stream of images tell; chosen.

    Attributes:
        uncalibrated_images: so many images waiting without a calibration of their own mean that
            calibrations are sent seldom or once; as many as replay has in flight.
        clock_jump_ns: a stamp that is older than the newest by more than this is no late image:
            the clock was set back.
    """

    uncalibrated_images: int = 4
    clock_jump_ns: int = 10**9


SETTINGS = AssemblerSettings()


class ViewAssembler:
    """Matches images by stamp, finds their poses, and skips what is not worth a view.

    Attributes:
        last_error: the last error's line by reason.
        notes: what had to be assumed of the messages, a line each.
    """

    def __init__(self, config: CollectorConfig, live: bool = True,
                 T_world_camera: np.ndarray | None = None, frame: str = "",
                 robot: Robot | None = None):
        """Makes an assembler without images.

        Args:
            config: settings.
            live: messages that stay away are given up after `tf_timeout_s` of awake time. Replay
                without ROS has nothing to wait for; there, nothing may depend on the clock.
            T_world_camera: (4, 4) pose of a fixed camera; None: it comes from TF or a topic.
            frame: name of the camera's frame in TF; empty: the one that its images name.
            robot: is left out of the depth; None: there is none in sight.
        """
        self._robot = robot if config.depth_topic else None
        self._T_world_camera, self._tf_frame = T_world_camera, frame
        self._config = config
        self._live = live
        self._tolerance_ns = round(config.sync_tolerance_s * 1e9)
        self._transforms = TransformBuffer(config.tf_max_gap_s)
        self._calibrations = Calibrations(self._tolerance_ns)
        self._depths = DepthStream(config, self._transforms, frame)
        self._calibrated_frame = ""
        self.notes: list[str] = []
        self.start()

    def start(self) -> None:
        """Begins a scan: forgets images and tally, keeps transforms and calibration."""
        self._waiting: deque[WaitingImage] = deque()
        self._depths.start()
        self._labels = ImageStream("labels", self._tolerance_ns)
        self._gate = ViewGate(self._config)
        self._skipped: Counter[str] = Counter()
        self._received = self._accepted = 0
        self._newest = self._behind = -1
        self._frame = ""
        self.last_error: dict[str, str] = {}

    def apply_gates(self, config: CollectorConfig) -> None:
        """Replaces the gates, since a node's parameters have changed."""
        self._config = config
        self._gate.apply_limits(config)

    @property
    def waiting(self) -> int:
        """Number of images that wait for their partners, calibration or pose."""
        return len(self._waiting)

    @property
    def tally(self) -> ViewTally:
        """Number of images received, views accepted, and images skipped by reason."""
        return ViewTally(self._received, self._accepted, dict(self._skipped))

    # --- messages in --------------------------------------------------------------------------

    def add_color(self, message: Any) -> None:
        """Takes a colour `Image` or `CompressedImage`, which every view has."""
        self._received += 1
        try:
            stamp, frame = decoding.stamp_ns(message.header.stamp), message.header.frame_id
            self._check_order(stamp, frame)
            self._waiting.append(WaitingImage(stamp, frame, self._decode_color(message),
                                              awake_time()))
        except ViewError as error:
            self._count_skipped(error)

    def _decode_color(self, message: Any) -> np.ndarray:
        """(h, w, 3) uint8 RGB of a message; says once what it does not say of itself."""
        topic = self._config.color_topic
        if (assumed := decoding.assumed_channels(message)) and not self.notes:
            self.notes.append(f"{topic}: {assumed}")
            _LOG.warning(self.notes[0])
        try:
            return decoding.color_to_array(message)
        except ViewError as error:
            raise error.on(topic) from error

    def _check_order(self, stamp: int, frame: str) -> None:
        self._frame = self._frame or frame
        if frame != self._frame:
            raise ViewError("frame_changed", f"image of '{frame}'; expected '{self._frame}' only: "
                                             "two cameras speak on one topic")
        if stamp == self._newest:
            raise ViewError("same_stamp", f"a second image with stamp {stamp} ns"
                            + ("" if stamp else "; expected stamps that grow: have the driver set "
                               "header.stamp"))
        behind, self._behind = self._behind, -1
        # Two stamps in a row that are far behind mean that the clock was set back.
        if -1 < behind < stamp < self._newest - SETTINGS.clock_jump_ns:
            self._restart_clock(stamp)
        elif stamp < self._newest:
            self._behind = stamp
            raise ViewError("time_backwards", f"stamp {stamp} ns after {self._newest} ns; "
                                              "expected stamps that grow")
        self._newest = stamp

    def _restart_clock(self, stamp: int) -> None:
        """Skips the images that wait: their clock was set back, their partners will not come."""
        for _ in self._waiting:
            self._count_skipped(ViewError(
                "time_jumped", f"the clock went back from {self._newest} ns"))
        self._waiting.clear()
        self._depths.restart(stamp)
        self._labels.restart(stamp)
        self._calibrations.restart()

    def add_depth(self, message: Any) -> None:
        """Takes a depth `Image` or `CompressedImage`."""
        self._depths.add_message(message)

    def add_depth_camera_info(self, message: Any) -> None:
        """Takes the depth images' own `CameraInfo`."""
        self._depths.add_camera_info(message)

    def add_labels(self, message: Any) -> None:
        """Takes a label `Image` that is aligned to colour."""
        self._labels.add_message(message, decoding.labels_to_array, self._config.labels_topic)

    def add_camera_info(self, message: Any) -> None:
        """Takes a `CameraInfo`; it is checked when a view needs it.

        Its frame is that of images that name none.
        """
        self._calibrated_frame = message.header.frame_id
        self._calibrations.add(decoding.stamp_ns(message.header.stamp),
                               decoding.intrinsics_of_camera_info(
                                   message, is_rectified(self._config.color_topic)))

    def add_transform(self, message: Any, static: bool) -> None:
        """Takes a `TransformStamped` of /tf or /tf_static; a damaged one is logged and dropped."""
        self._add_pose(message.header, message.child_frame_id, message.transform,
                       decoding.transform_to_matrix, static)

    def add_pose(self, message: Any) -> None:
        """Takes a `PoseStamped` of the optical frame."""
        self._add_pose(
            message.header, _POSE_TOPIC_FRAME, message.pose, decoding.pose_to_matrix, False
        )

    def _add_pose(self, header: Any, child: str, pose: Any, decode: Any, static: bool) -> None:
        try:
            self._transforms.add_transform(
                decoding.stamp_ns(header.stamp), header.frame_id.lstrip("/"), child.lstrip("/"),
                decode(pose), static)
        except ViewError as error:
            self._log_first(error.on(child))

    # --- views out ----------------------------------------------------------------------------

    def poll(self) -> list[View]:
        """Returns the views that are complete now, in stamp order."""
        return self._decide_waiting(everything=False)

    def flush(self) -> list[View]:
        """Decides all images that wait, as at the end of a scan or bag; returns their views."""
        return self._decide_waiting(everything=True)

    def _decide_waiting(self, everything: bool) -> list[View]:
        """Accepts or skips the images that wait, oldest first, up to one that is incomplete."""
        views, now = [], awake_time()
        while self._waiting:
            head = self._waiting[0]
            late = self._live and now - head.since >= self._config.tf_timeout_s
            patient = not (everything or late or len(self._waiting) > MAX_QUEUED_MESSAGES)
            if patient and not self._is_complete(head):
                break
            try:
                views.append(self._make_view(head))
                self._accepted += 1
            except ViewError as error:
                self._count_skipped(error)
            self._waiting.popleft()
            self._calibrations.note_decided(head.stamp_ns)
            self._depths.note_decided(head.stamp_ns)
            self._labels.forget_before(head.stamp_ns)
        return views

    def _is_complete(self, head: WaitingImage) -> bool:
        """Tells whether no message that may still come can change this view."""
        # With newer images there, a calibration sent with this very one would have come.
        patient = len(self._waiting) < SETTINGS.uncalibrated_images
        intrinsics = self._calibrations.calibration_at(head.stamp_ns)
        return (intrinsics is not None
                and (not patient or self._calibrations.is_settled(head.stamp_ns))
                and (not self._config.depth_topic or self._depths.is_settled(
                    head.stamp_ns, self._frame_of(head), intrinsics, patient, bool(head.frame)))
                and (not self._config.labels_topic or self._labels.is_settled(head.stamp_ns))
                and self._has_pose(head)
                and (not self._robot or self._robot.is_ready(head.stamp_ns, self._transforms)))

    def _has_pose(self, head: WaitingImage) -> bool:
        return self._T_world_camera is not None or self._transforms.is_ready(
            self._config.world_frame, self._source_frame(head), head.stamp_ns)

    def _source_frame(self, head: WaitingImage) -> str:
        if self._config.pose_source == "topic":
            return _POSE_TOPIC_FRAME
        return (self._tf_frame or self._frame_of(head)).lstrip("/")

    def _frame_of(self, head: WaitingImage) -> str:
        """The frame that an image names, or else its calibration."""
        return head.frame or self._calibrated_frame

    def _make_view(self, head: WaitingImage) -> View:
        """Makes the view of a colour image.

        Raises:
            ViewError: the image is skipped: it lacks a calibration, its partners or its pose, does
                not fit them, is blurred, or shows nothing new.
        """
        intrinsics = self._calibrations.calibration_of(head.color, head.stamp_ns,
                                                       self._config.camera_info_topic)
        labels = None
        if self._config.labels_topic:
            labels = self._labels.nearest_image(head.color, head.stamp_ns, "bad_labels")
        T, fixed = self._find_pose(head)
        view = View(head.stamp_ns, intrinsics, geometry.canonical_pose(T), head.color, None,
                    labels, self._frame_of(head), fixed)
        if not self._config.depth_topic:
            self._gate.check(view)
            return view
        # What costs time is done for views that are kept.
        depth = self._depths.find(view)
        posture = self._robot.posture_at(head.stamp_ns, self._transforms) if self._robot else None
        self._gate.check(replace(view, depth=depth.image))
        view = depth.added_to(view)
        return self._robot.leave_out_of(view, posture) if self._robot and posture else view

    def _find_pose(self, head: WaitingImage) -> tuple[np.ndarray, bool]:
        if self._T_world_camera is not None:
            return self._T_world_camera, True
        return self._transforms.lookup(
            self._config.world_frame, self._source_frame(head), head.stamp_ns
        )

    def _count_skipped(self, error: ViewError) -> None:
        """Counts a skipped image under its reason, and logs the first of its kind."""
        self._skipped[error.reason] += 1
        self._log_first(error)

    def _log_first(self, error: ViewError) -> None:
        """Logs the first error of its kind; the others are only counted."""
        if error.reason not in self.last_error:
            _LOG.warning("view skipped: %s", error)
        self.last_error[error.reason] = str(error)
