"""Writes views as a rosbag2 folder with the RealSense wrapper's topic names."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path

import cv2
import numpy as np
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

Transform = tuple[int, str, str, np.ndarray]  # stamp in ns, parent, child, T_parent_child


def write_bag(path: Path, views: Iterable[View], transforms: Sequence[Transform] | None = None,
              world_frame: str = "base_link", jpegs: Sequence[bytes] | None = None) -> int:
    """Writes one camera's views.

    Args:
        path: a new folder.
        views: colour is written as JPEG, depth as 16UC1 millimetres, labels as mono8.
        transforms: samples of /tf; None writes each view's pose at its stamp and 20 ms around it.
        world_frame: parent of those poses.
        jpegs: colour images as they are, instead of encoding the views'.

    Returns:
        The number of views.

    Raises:
        BagError: the path exists.
    """
    if path.exists():
        raise BagError(f"{path} exists; expected a new path")
    messages: list[tuple[int, str, str, object]] = []
    count = 0
    for count, view in enumerate(views, 1):
        messages += _view_messages(view, jpegs[count - 1] if jpegs else None)
        if transforms is None:
            messages += [_tf(stamp, world_frame, view.camera, view.T_world_camera) for stamp in
                         (view.stamp_ns - _TF_STEP_NS, view.stamp_ns, view.stamp_ns + _TF_STEP_NS)]
    messages += [_tf(*transform) for transform in transforms or ()]
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    with writer:
        connections = {}
        for stamp, topic, kind, message in sorted(messages, key=lambda m: m[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=_STORE)
            writer.write(connections[topic], stamp, _STORE.serialize_cdr(message, kind))
    return count


def _header(stamp_ns: int, frame: str) -> object:
    time = _T["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    return _T["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _view_messages(view: View, jpeg: bytes | None) -> list[tuple[int, str, str, object]]:
    stamp, header = view.stamp_ns, _header(view.stamp_ns, view.camera)
    out: list[tuple[int, str, str, object]] = [
        (stamp, INFO, "sensor_msgs/msg/CameraInfo", _camera_info(view.intrinsics, header))]
    if jpeg is None and view.color is not None:
        done, data = cv2.imencode(".jpg", view.color[..., ::-1], [cv2.IMWRITE_JPEG_QUALITY,
                                                                  _QUALITY])
        jpeg = data.tobytes() if done else None
    if jpeg is not None:
        kind = "sensor_msgs/msg/CompressedImage"
        out.append((stamp, f"{COLOR}/compressed", kind, _T[kind](
            header=header, format="rgb8; jpeg compressed bgr8",
            data=np.frombuffer(jpeg, np.uint8))))
    if view.depth is not None:
        millimetres = np.clip(np.round(view.depth * 1000), 0, 65535).astype(np.uint16)
        out.append((stamp, DEPTH, "sensor_msgs/msg/Image", _image(millimetres, "16UC1", header)))
    if view.labels is not None:
        out.append((stamp, LABELS, "sensor_msgs/msg/Image", _image(view.labels, "mono8", header)))
    return out


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


def _tf(stamp_ns: int, parent: str, child: str, T: np.ndarray) -> tuple[int, str, str, object]:
    x, y, z, w = (float(q) for q in geometry.quaternion_from_pose(T))
    transform = _T["geometry_msgs/msg/Transform"](
        translation=_T["geometry_msgs/msg/Vector3"](*(float(t) for t in T[:3, 3])),
        rotation=_T["geometry_msgs/msg/Quaternion"](x, y, z, w))
    stamped = _T["geometry_msgs/msg/TransformStamped"](
        header=_header(stamp_ns, parent), child_frame_id=child, transform=transform)
    return stamp_ns, "/tf", "tf2_msgs/msg/TFMessage", _T["tf2_msgs/msg/TFMessage"]([stamped])
