"""Writes views as a rosbag2 folder with the RealSense wrapper's topic names."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

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
from stack_counter.errors import BagError
from stack_counter.types import Intrinsics, View

COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO, LABELS = "/camera/color/camera_info", "/camera/labels"
_QUALITY = 90  # JPEG
_TF_STEP_NS = 20_000_000
_STORE = get_typestore(Stores.ROS2_JAZZY)
_T = _STORE.types
_FOREVER = QosTime(9223372036, 854775807)
_LATCHED = Qos(QosHistory.KEEP_LAST, 100, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
               _FOREVER, _FOREVER, QosLiveliness.AUTOMATIC, _FOREVER, False)

Transform = tuple[int, str, str, np.ndarray]  # stamp in ns, parent, child, T_parent_child
_Message = tuple[int, str, str, object]  # log time in ns, topic, type, message


def write_bag(path: Path, views: Iterable[View], transforms: Sequence[Transform] | None = None,
              world_frame: str = "base_link", jpegs: Sequence[bytes] | None = None,
              static: Sequence[Transform] = (), compressed: bool = True) -> int:
    """Writes one camera's views.

    Args:
        path: a new folder.
        views: depth is written as 16UC1 millimetres, labels as mono8.
        transforms: samples of /tf; None writes each view's pose at its stamp and 20 ms around it.
        world_frame: parent of those poses.
        jpegs: colour images as they are, instead of encoding the views'.
        static: transforms of /tf_static.
        compressed: colour as JPEG rather than raw.

    Returns:
        The number of views.

    Raises:
        BagError: the path exists.
    """
    if path.exists():
        raise BagError(f"{path} exists; expected a new path")
    messages: list[_Message] = [_tf(*transform, topic="/tf_static") for transform in static]
    count = 0
    for count, view in enumerate(views, 1):
        header = _header(view.stamp_ns, view.camera)
        messages += _images(view, header)
        if jpegs or (compressed and view.color is not None):
            messages.append(_jpeg(view, header, jpegs[count - 1] if jpegs else None))
        elif view.color is not None:
            messages.append((view.stamp_ns, COLOR, "sensor_msgs/msg/Image",
                             _image(view.color, "rgb8", header)))
        if transforms is None:
            messages += [_tf(stamp, world_frame, view.camera, view.T_world_camera) for stamp in
                         (view.stamp_ns - _TF_STEP_NS, view.stamp_ns, view.stamp_ns + _TF_STEP_NS)]
    messages += [_tf(*transform) for transform in transforms or ()]
    _write(path, sorted(messages, key=lambda message: message[0]))
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
    messages: list[_Message] = [_tf(*transform, topic="/tf_static") for transform in static]
    for name, views in cameras.items():
        for view in views:
            header = _header(view.stamp_ns, view.camera)
            messages += [(stamp, topic.replace("/camera", f"/{name}", 1), kind, message)
                         for stamp, topic, kind, message in
                         [*_images(view, header), _jpeg(view, header, None)]]
    _write(path, sorted(messages, key=lambda message: message[0]))


def _write(path: Path, messages: list[_Message]) -> None:
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for stamp, topic, kind, message in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=_STORE,
                    offered_qos_profiles=[_LATCHED] if topic == "/tf_static" else [])
            writer.write(connections[topic], stamp, _STORE.serialize_cdr(message, kind))


def _header(stamp_ns: int, frame: str) -> object:
    time = _T["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return _T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _images(view: View, header: object) -> list[_Message]:
    """Calibration, depth and labels of a view."""
    out: list[_Message] = [(view.stamp_ns, INFO, "sensor_msgs/msg/CameraInfo",
                            _camera_info(view.intrinsics, header))]
    if view.depth is not None:
        millimetres = np.clip(np.round(view.depth * 1000), 0, 65535).astype(np.uint16)
        out.append((view.stamp_ns, DEPTH, "sensor_msgs/msg/Image",
                    _image(millimetres, "16UC1", header)))
    if view.labels is not None:
        out.append((view.stamp_ns, LABELS, "sensor_msgs/msg/Image",
                    _image(view.labels, "mono8", header)))
    return out


def _jpeg(view: View, header: object, data: bytes | None) -> _Message:
    if data is None:
        assert view.color is not None  # for the type checker
        options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY]
        data = cv2.imencode(".jpg", view.color[..., ::-1], options)[1].tobytes()
    kind = "sensor_msgs/msg/CompressedImage"
    return (view.stamp_ns, f"{COLOR}/compressed", kind,
            _T[kind](header=header, format="rgb8; jpeg compressed bgr8",
                     data=np.frombuffer(data, np.uint8)))


def _image(pixels: np.ndarray, encoding: str, header: object) -> object:
    return _T["sensor_msgs/msg/Image"](
        header=header, height=pixels.shape[0], width=pixels.shape[1], encoding=encoding,
        is_bigendian=0, step=pixels[0].nbytes,
        data=np.frombuffer(np.ascontiguousarray(pixels).tobytes(), np.uint8))


def _camera_info(k: Intrinsics, header: object) -> object:
    roi = _T["sensor_msgs/msg/RegionOfInterest"](x_offset=0, y_offset=0, height=0, width=0,
                                                 do_rectify=False)
    P = np.hstack([k.K, np.zeros((3, 1))])
    return _T["sensor_msgs/msg/CameraInfo"](
        header=header, height=k.height, width=k.width,
        distortion_model=k.distortion_model or "plumb_bob",
        d=np.array(k.distortion or (0.0,) * 5, float), k=k.K.ravel(), r=np.eye(3).ravel(),
        p=P.ravel(), binning_x=0, binning_y=0, roi=roi)


def _tf(stamp_ns: int, parent: str, child: str, T: np.ndarray, topic: str = "/tf") -> _Message:
    x, y, z, w = (float(q) for q in geometry.quaternion_from_pose(T))
    transform = _T["geometry_msgs/msg/Transform"](
        translation=_T["geometry_msgs/msg/Vector3"](*(float(t) for t in T[:3, 3])),
        rotation=_T["geometry_msgs/msg/Quaternion"](x, y, z, w))
    stamped = _T["geometry_msgs/msg/TransformStamped"](
        header=_header(stamp_ns, parent), child_frame_id=child, transform=transform)
    return stamp_ns, topic, "tf2_msgs/msg/TFMessage", _T["tf2_msgs/msg/TFMessage"]([stamped])
