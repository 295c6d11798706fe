# SPDX-License-Identifier: Apache-2.0
"""Writes views as a rosbag2 folder with the RealSense wrapper's topic names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import repeat
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from stack_counter import geometry
from stack_counter.bag.bag_views import SCALE_TOPIC
from stack_counter.errors import BagError
from stack_counter.types import Intrinsics, View

COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO, LABELS = "/camera/color/camera_info", "/camera/labels"
_STORE = get_typestore(Stores.ROS2_JAZZY)
_TYPES = _STORE.types
_FOREVER = QosTime(9223372036, 854775807)
_LATCHED = Qos(QosHistory.KEEP_LAST, 100, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
               _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)

_LATCHED_TOPICS = ("/tf_static", SCALE_TOPIC)


@dataclass(frozen=True)
class WriterSettings:
    """How views are recorded.

    Attributes:
        jpeg_quality: of compressed colour images; chosen.
        tf_step_ns: time before and after a view at which its pose is written too, ns, so that it
            can be interpolated; chosen.
    """

    jpeg_quality: int = 90
    tf_step_ns: int = 20_000_000


SETTINGS = WriterSettings()


class Transform(NamedTuple):
    """A transform between two frames.

    Attributes:
        stamp_ns: time at which it holds, ns.
        parent: frame.
        child: frame.
        T_parent_child: (4, 4) float64.
    """

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: np.ndarray


class _Message(NamedTuple):
    """A message to be written, and its log time, ns."""

    log_time_ns: int
    topic: str
    kind: str
    message: object


def write_bag(path: Path, views: Iterable[View], transforms: Sequence[Transform] | None = None,
              world_frame: str = "base_link", jpegs: Iterable[bytes] | None = None,
              static: Sequence[Transform] = (), compressed: bool = True,
              scale_std: float = 0.0) -> int:
    """Writes one camera's views.

    Args:
        path: a new folder.
        views: depth is written as 16UC1 millimetres, labels as mono8.
        transforms: samples of /tf; None writes each view's pose at its stamp and 20 ms around it.
        world_frame: parent of those poses.
        jpegs: colour image of every view, written as it is instead of the views' own.
        static: transforms of /tf_static.
        compressed: whether colour is written as JPEG rather than raw.
        scale_std: relative standard deviation of all lengths in the poses; written if not 0.

    Returns:
        Number of views.

    Raises:
        BagError: the path exists.
    """
    if path.exists():
        raise BagError(f"{path} exists; expected a new path")
    messages = [_tf_message(*transform, topic="/tf_static") for transform in static]
    content: Iterable[bytes | None] = repeat(None) if jpegs is None else jpegs
    count = 0
    for view, jpeg in zip(views, content):
        count += 1
        # The view's calibration, depth, labels and colour.
        header = _header(view.stamp_ns, view.camera)
        messages += _image_messages(view, header)
        if jpeg or (compressed and view.color is not None):
            messages.append(_jpeg_message(view, header, jpeg))
        elif view.color is not None:
            messages.append(_Message(view.stamp_ns, COLOR, "sensor_msgs/msg/Image",
                                     _image(view.color, "rgb8", header)))
        # Its pose, before, at and after its stamp.
        if transforms is None:
            messages += [_tf_message(view.stamp_ns + step * SETTINGS.tf_step_ns, world_frame,
                                     view.camera, view.T_world_camera) for step in (-1, 0, 1)]
    messages += [_tf_message(*transform) for transform in transforms or ()]
    if scale_std and messages:
        first_ns = min(message.log_time_ns for message in messages)
        messages.append(_Message(first_ns, SCALE_TOPIC, "std_msgs/msg/Float64",
                                 _TYPES["std_msgs/msg/Float64"](data=scale_std)))
    _write_messages(path, messages)
    return count


def write_rig_bag(path: Path, cameras: Mapping[str, Sequence[View]],
                  static: Sequence[Transform] = ()) -> None:
    """Writes the views of several cameras, each below a topic of its name.

    Args:
        path: a new folder.
        cameras: views by camera name.
        static: transforms of /tf_static.

    Raises:
        BagError: the path exists.
    """
    if path.exists():
        raise BagError(f"{path} exists; expected a new path")
    messages = [_tf_message(*transform, topic="/tf_static") for transform in static]
    for name, views in cameras.items():
        for view in views:
            header = _header(view.stamp_ns, view.camera)
            messages += [message._replace(topic=message.topic.replace("/camera", f"/{name}", 1))
                         for message in (*_image_messages(view, header),
                                         _jpeg_message(view, header, None))]
    _write_messages(path, messages)


def _write_messages(path: Path, messages: list[_Message]) -> None:
    """Writes messages in the order of their log times."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for log_time_ns, topic, kind, message in sorted(messages, key=lambda m: m.log_time_ns):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=_STORE,
                    offered_qos_profiles=[_LATCHED] if topic in _LATCHED_TOPICS else [])
            writer.write(connections[topic], log_time_ns, _STORE.serialize_cdr(message, kind))


def _header(stamp_ns: int, frame: str) -> object:
    time = _TYPES["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return _TYPES["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _image_messages(view: View, header: object) -> list[_Message]:
    """Calibration, depth and labels of a view."""
    out = [_Message(view.stamp_ns, INFO, "sensor_msgs/msg/CameraInfo",
                    _camera_info(view.intrinsics, header))]
    if view.depth is not None:
        millimetres = np.clip(np.round(view.depth * 1000), 0, 65535).astype(np.uint16)
        out.append(_Message(view.stamp_ns, DEPTH, "sensor_msgs/msg/Image",
                            _image(millimetres, "16UC1", header)))
    if view.labels is not None:
        out.append(_Message(view.stamp_ns, LABELS, "sensor_msgs/msg/Image",
                            _image(view.labels, "mono8", header)))
    return out


def _jpeg_message(view: View, header: object, data: bytes | None) -> _Message:
    """Compressed colour of a view: `data`, or else its own colour."""
    if data is None:
        assert view.color is not None  # for the type checker
        options = [cv2.IMWRITE_JPEG_QUALITY, SETTINGS.jpeg_quality]
        data = cv2.imencode(".jpg", view.color[..., ::-1], options)[1].tobytes()
    kind = "sensor_msgs/msg/CompressedImage"
    message = _TYPES[kind](header=header, format="rgb8; jpeg compressed bgr8",
                           data=np.frombuffer(data, np.uint8))
    return _Message(view.stamp_ns, f"{COLOR}/compressed", kind, message)


def _image(pixels: np.ndarray, encoding: str, header: object) -> object:
    return _TYPES["sensor_msgs/msg/Image"](
        header=header, height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
        is_bigendian=0, step=pixels[0].nbytes,
        data=np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8))


def _camera_info(k: Intrinsics, header: object) -> object:
    roi = _TYPES["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0,
                                                     do_rectify=False)
    P = np.hstack([k.K, np.zeros((3, 1))])
    return _TYPES["sensor_msgs/msg/CameraInfo"](
        header=header, height=k.height, width=k.width,
        distortion_model=k.distortion_model or "plumb_bob",
        d=np.array(k.distortion or (0.0,) * 5, float), k=k.K.ravel(), r=np.eye(3).ravel(),
        p=P.ravel(), binning_x=0, binning_y=0, roi=roi)


def _tf_message(stamp_ns: int, parent: str, child: str, T: np.ndarray, topic: str = "/tf"
                ) -> _Message:
    x, y, z, w = (float(q) for q in geometry.quaternion_from_pose(T))
    transform = _TYPES["geometry_msgs/msg/Transform"](
        translation=_TYPES["geometry_msgs/msg/Vector3"](*(float(t) for t in T[:3, 3])),
        rotation=_TYPES["geometry_msgs/msg/Quaternion"](x, y, z, w))
    stamped = _TYPES["geometry_msgs/msg/TransformStamped"](
        header=_header(stamp_ns, parent), child_frame_id=child, transform=transform)
    kind = "tf2_msgs/msg/TFMessage"
    return _Message(stamp_ns, topic, kind, _TYPES[kind]([stamped]))
