# SPDX-License-Identifier: Apache-2.0
"""Depth images of one colour camera, whether they are aligned to its images or another camera's.

Depth is aligned if its frame is the colour images' and its calibration, if it has one, is theirs.
Other depth is registered by calibration and TF, or the view is refused: taken as aligned it would
give a wrong V.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import Intrinsics, View
from stack_counter.views import decoding
from stack_counter.views.camera_search import is_rectified
from stack_counter.views.color_transport import without_transport
from stack_counter.views.depth_registration import register_depth
from stack_counter.views.image_stream import Calibrations, ImageStream
from stack_counter.views.tf_buffer import TransformBuffer


@dataclass(frozen=True)
class DepthStreamSettings:
    """When two cameras are one; chosen.

    Attributes:
        same_px: largest difference of focal lengths and principal points, pixels.
        same_distortion: largest difference of a coefficient of the distortion.
        same_pose: largest difference of places, metres, and of a rotation matrix's elements.
    """

    same_px: float = 0.5
    same_distortion: float = 1e-3
    same_pose: float = 1e-4


SETTINGS = DepthStreamSettings()


def depth_camera_info_topic(config: CollectorConfig) -> str:
    """Topic of the depth images' own calibration; empty if they have none of their own.

    Unless it is configured, it lies beside the images, as image_transport's cameras have it.
    """
    if not config.depth_topic or config.depth_camera_info_topic == config.camera_info_topic:
        return ""
    return config.depth_camera_info_topic or \
        f"{without_transport(config.depth_topic).rpartition('/')[0]}/camera_info"


@dataclass(frozen=True, eq=False)
class FoundDepth:
    """A depth image that belongs to a view.

    Attributes:
        image: (h, w) float32 metres along its own camera's optical z, 0 where invalid.
        intrinsics: calibration of that camera.
        T_color_depth: (4, 4) where that camera is beside the view's; None for aligned depth.
    """

    image: np.ndarray
    intrinsics: Intrinsics
    T_color_depth: np.ndarray | None

    def added_to(self, view: View) -> View:
        """The view with this depth; where that has to be registered, the view is rectified.

        Raises:
            ViewError: the two cameras see nothing in common (`empty_depth`), or a calibration
                cannot be one (`bad_intrinsics`).
        """
        if self.T_color_depth is None:
            return replace(view, depth=self.image)
        own = geometry.rectify(replace(view, intrinsics=self.intrinsics, depth=self.image,
                                       color=None, labels=None))
        view = geometry.rectify(view)
        registered = register_depth(np.asarray(own.depth), own.intrinsics, view.intrinsics,
                                    self.T_color_depth)
        if not registered.any():
            raise ViewError("empty_depth", "nothing that the depth camera sees is in the image of "
                                           f"'{view.camera}'; expected some: check the transform "
                                           "between them")
        return replace(view, depth=registered)


class DepthStream:
    """Matches depth with colour images by stamp, and brings it into their pixels."""

    def __init__(self, config: CollectorConfig, transforms: TransformBuffer, frame: str = ""):
        """Makes a stream without images.

        Args:
            config: names the topics.
            transforms: says where the depth camera is beside the colour camera.
            frame: name of the colour camera's frame in TF; empty: the one that its images name.
        """
        self._config, self._transforms, self._tf_frame = config, transforms, frame
        self._tolerance_ns = round(config.sync_tolerance_s * 1e9)
        self._info_topic = depth_camera_info_topic(config)
        self._calibrations = Calibrations(self._tolerance_ns)
        self._calibrated_frame = ""
        self.start()

    def start(self) -> None:
        """Begins a scan: forgets images, keeps calibrations."""
        self._images = ImageStream("depth", self._tolerance_ns)

    def restart(self, stamp_ns: int) -> None:
        """Forgets what is later than the stamp, since the clock was set back to it."""
        self._images.restart(stamp_ns)
        self._calibrations.restart()

    def note_decided(self, stamp_ns: int) -> None:
        """Notes that the colour image of this stamp is accepted or skipped."""
        self._images.forget_before(stamp_ns)
        self._calibrations.note_decided(stamp_ns)

    def add_message(self, message: Any) -> None:
        """Takes a depth `Image` or `CompressedImage`."""
        self._images.add_message(
            message, partial(decoding.depth_to_metres, scale=self._config.depth_scale),
            self._config.depth_topic)

    def add_camera_info(self, message: Any) -> None:
        """Takes the depth images' own `CameraInfo`; its frame is that of images that name none."""
        self._calibrated_frame = message.header.frame_id.lstrip("/")
        self._calibrations.add(decoding.stamp_ns(message.header.stamp),
                               decoding.intrinsics_of_camera_info(
                                   message, is_rectified(self._config.depth_topic)))

    def is_settled(self, stamp_ns: int, frame: str, intrinsics: Intrinsics, patient: bool,
                   is_named: bool) -> bool:
        """Tells whether no message that may still come can change the depth of a colour image.

        Args:
            stamp_ns: of the colour image.
            frame: of the colour image.
            intrinsics: of the colour image.
            patient: a depth calibration that is sent with this very image may still come.
            is_named: the colour image itself names its frame; of a driver whose images do not,
                the calibrations say whether depth is in that of colour.
        """
        if not self._images.is_settled(stamp_ns):
            return False
        try:
            named_frame, _ = self._images.nearest(stamp_ns)
        except ViewError:
            return True
        if patient and self._info_topic and not (is_named or named_frame or self._calibrations):
            return False
        depth_frame = named_frame or self._calibrated_frame
        elsewhere = self._is_elsewhere(depth_frame, frame)
        # A calibration is waited for where it is needed, named, or known to be sent.
        wanted = elsewhere or self._is_info_named or bool(self._calibrations)
        if wanted and not self._calibrations.is_settled(stamp_ns) \
                and (patient or not self._calibrations):
            return False
        own = self._calibration_at(stamp_ns)
        return not elsewhere or own is None or _have_same_pixels(own, intrinsics) \
            or self._transforms.is_ready(self._color_frame(frame), depth_frame, stamp_ns)

    def find(self, view: View) -> FoundDepth:
        """The depth of a view.

        Args:
            view: with colour; `camera` is the frame that its image names.

        Raises:
            ViewError: no depth image is near enough (`unsynchronised`) or it could not be decoded,
                its size is not that of its calibration (`bad_depth`), or it is another camera's
                whose calibration or place is unknown (`depth_not_aligned`).
        """
        named_frame, depth = self._images.nearest(view.stamp_ns)
        depth_frame = named_frame or self._calibrated_frame
        elsewhere = self._is_elsewhere(depth_frame, view.camera)
        own = self._calibration_at(view.stamp_ns)
        if own is None and (elsewhere or self._is_info_named and not self._calibrations):
            raise self._not_aligned(depth_frame, view, f"no calibration on {self._info_topic}")
        k = own or view.intrinsics
        if depth.shape != (k.height, k.width):
            raise ViewError("bad_depth", f"depth of {depth.shape[1]}x{depth.shape[0]}; expected "
                                         f"{k.width}x{k.height} as "
                                         f"{'its calibration' if own else 'the colour'}: set "
                                         "depth_topic to depth aligned to colour, or "
                                         "depth_camera_info_topic to its calibration")
        same_pixels = _have_same_pixels(k, view.intrinsics)
        T = self._pose_beside_color(depth_frame, view, same_pixels) if elsewhere else np.eye(4)
        aligned = same_pixels and np.allclose(T, np.eye(4), atol=SETTINGS.same_pose)
        return FoundDepth(depth, k, None if aligned else T)

    @property
    def _is_info_named(self) -> bool:
        """Whether the settings, not a rule, say where the depth calibration comes from."""
        return bool(self._info_topic and self._config.depth_camera_info_topic)

    def _is_elsewhere(self, depth_frame: str, frame: str) -> bool:
        """Whether depth names a frame that is not colour's, and nobody says that it is aligned."""
        return bool(self._info_topic) and depth_frame not in (
            "", frame.lstrip("/"), self._tf_frame.lstrip("/"))

    def _color_frame(self, frame: str) -> str:
        """Name in TF of the colour camera whose images name this frame."""
        return (self._tf_frame or frame).lstrip("/")

    def _calibration_at(self, stamp_ns: int) -> Intrinsics | None:
        """The depth images' own calibration; None if there is none, or one of an unset driver."""
        own = self._calibrations.calibration_at(stamp_ns)
        return own if own is not None and own.fx > 0 else None

    def _pose_beside_color(self, depth_frame: str, view: View, same_pixels: bool) -> np.ndarray:
        """(4, 4) from the depth camera's frame to the colour camera's.

        Depth in the very pixels of colour is aligned unless TF says otherwise: some drivers give
        aligned depth a frame of its own that nobody publishes.

        Raises:
            ViewError: TF does not say it.
        """
        try:
            return self._transforms.lookup(self._color_frame(view.camera), depth_frame,
                                           view.stamp_ns)[0]
        except ViewError as error:
            if same_pixels:
                return np.eye(4)
            raise self._not_aligned(depth_frame, view, str(error)) from error

    def _not_aligned(self, depth_frame: str, view: View, missing: str) -> ViewError:
        return ViewError(
            "depth_not_aligned", f"depth is of '{depth_frame or view.camera}', colour of "
            f"'{view.camera}', and {missing}; expected calibration and /tf_static of the depth "
            "camera, or aligned depth (if it is, set depth_camera_info_topic to "
            f"{self._config.camera_info_topic})")


def _have_same_pixels(a: Intrinsics, b: Intrinsics) -> bool:
    """Whether two calibrations are of one image."""
    if a == b:
        return True
    length = max(len(a.distortion), len(b.distortion))
    distortion_a, distortion_b = (
        np.pad(k.distortion, (0, length - len(k.distortion))) for k in (a, b))
    return (a.width, a.height) == (b.width, b.height) \
        and np.allclose((a.fx, a.fy, a.cx, a.cy), (b.fx, b.fy, b.cx, b.cy), rtol=0,
                        atol=SETTINGS.same_px) \
        and np.allclose(distortion_a, distortion_b, rtol=0, atol=SETTINGS.same_distortion)
