# SPDX-License-Identifier: Apache-2.0
"""Messages and bags made in code, by rosbags: the library that the reader does not use."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
from kits.analytic import Scene
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from stack_counter import geometry
from stack_counter.types import Intrinsics

STORE = get_typestore(Stores.ROS2_JAZZY)
FRAME, WORLD = "camera_color_optical_frame", "base_link"
COLOR, DEPTH = "/camera/color/image_raw", "/camera/aligned_depth_to_color/image_raw"
INFO, LABELS = "/camera/color/camera_info", "/camera/labels"
IMAGE, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
CAMERA_INFO, TF = "sensor_msgs/msg/CameraInfo", "tf2_msgs/msg/TFMessage"
SMALL = Intrinsics(160, 120, 152.5, 152.5, 79.5, 59.5)


def make(kind, **fields):
    """A message of rosbags' own classes."""
    return STORE.types[kind](**fields)


def header(stamp_ns, frame=FRAME):
    """A `std_msgs/Header`."""
    stamp = make("builtin_interfaces/msg/Time", sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)
    return make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def image(pixels, encoding, stamp_ns=0, frame=FRAME, padding=0, bigendian=False):
    """An `Image`; `padding` bytes of 0xAB end every row."""
    pixels = np.ascontiguousarray(pixels)
    if bigendian:
        pixels = pixels.astype(pixels.dtype.newbyteorder(">"))
    height, width = pixels.shape[:2]
    rows = np.frombuffer(pixels.tobytes(), np.uint8).reshape(height, -1)
    rows = np.pad(rows, ((0, 0), (0, padding)), constant_values=0xAB)
    return make(IMAGE, header=header(stamp_ns, frame), height=height, width=width,
                encoding=encoding, is_bigendian=int(bigendian), step=rows.shape[1],
                data=rows.ravel())


def compressed(rgb, suffix=".png", stamp_ns=0, frame=FRAME):
    """A `CompressedImage`."""
    data = cv2.imencode(suffix, np.ascontiguousarray(rgb[..., ::-1]))[1].ravel()
    return make(COMPRESSED, header=header(stamp_ns, frame),
                format=f"rgb8; {suffix[1:]} compressed bgr8", data=data)


def camera_info(intrinsics, stamp_ns=0, frame=FRAME):
    """A `CameraInfo`."""
    K = intrinsics.K
    roi = make("sensor_msgs/msg/RegionOfInterest", x_offset=0, y_offset=0, height=0, width=0,
               do_rectify=False)
    return make(CAMERA_INFO, header=header(stamp_ns, frame), height=intrinsics.height,
                width=intrinsics.width,
                distortion_model=intrinsics.distortion_model or "plumb_bob",
                d=np.array(intrinsics.distortion or (0.0,) * 5), k=K.ravel(), r=np.eye(3).ravel(),
                p=np.hstack([K, np.zeros((3, 1))]).ravel(), binning_x=0, binning_y=0, roi=roi)


def quaternion(T):
    """A `geometry_msgs/Quaternion`."""
    x, y, z, w = map(float, geometry.quaternion_from_pose(T))
    return make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def transform(stamp_ns, T, child=FRAME, parent=WORLD):
    """A `TransformStamped`."""
    x, y, z = map(float, T[:3, 3])
    return make("geometry_msgs/msg/TransformStamped", header=header(stamp_ns, parent),
                child_frame_id=child, transform=make(
                    "geometry_msgs/msg/Transform", rotation=quaternion(T),
                    translation=make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)))


def pose_stamped(stamp_ns, T, frame=WORLD):
    """A `PoseStamped`."""
    x, y, z = map(float, T[:3, 3])
    return make("geometry_msgs/msg/PoseStamped", header=header(stamp_ns, frame), pose=make(
        "geometry_msgs/msg/Pose", orientation=quaternion(T),
        position=make("geometry_msgs/msg/Point", x=x, y=y, z=z)))


def texture(camera=SMALL, seed=0):
    """(h, w, 3) uint8 RGB in which every neighbour differs."""
    shape = (camera.height // 4 + 1, camera.width // 4 + 1, 3)
    coarse = np.random.default_rng(seed).integers(0, 256, shape).astype(np.uint8)
    return coarse.repeat(4, 0).repeat(4, 1)[:camera.height, :camera.width]


@lru_cache
def scan(kind="bin", count=6, camera=SMALL):
    """Views, coloured, of a filled bin, an empty bin or the bare plane; 1 s apart from 1 s on."""
    scene = Scene()
    if kind != "plane":
        scene.bin((0.18, 0.14, 0.10), 0.004, 0.004, {"bin": 0.06, "empty": 0.0}[kind])
    return tuple(replace(view, stamp_ns=view.stamp_ns + 10**9, color=texture(camera, i),
                         camera=FRAME)
                 for i, view in enumerate(scene.views(count, tilts=(10, 35), camera=camera)))


def records(views, poses=True):
    """What a camera and an arm say about these views: (stamp_ns, topic, kind, message)."""
    out = []
    for view in views:
        stamp = view.stamp_ns
        if poses:
            out += [tf_record(stamp + late, view.T_world_camera, view.camera)
                    for late in (-20_000_000, 0, 20_000_000)]
        out.append((stamp, INFO, CAMERA_INFO, camera_info(view.intrinsics, stamp, view.camera)))
        if view.color is not None:
            out.append((stamp, COLOR, IMAGE, image(view.color, "rgb8", stamp, view.camera)))
        if view.depth is not None:
            depth = np.round(view.depth * 1000).astype(np.uint16)
            out.append((stamp, DEPTH, IMAGE, image(depth, "16UC1", stamp, view.camera)))
        if view.labels is not None:
            out.append((stamp, LABELS, IMAGE, image(view.labels, "mono8", stamp, view.camera)))
    return out


def tf_record(stamp_ns, T, child=FRAME, parent=WORLD, topic="/tf"):
    """A `TFMessage` of one transform, as a record."""
    return stamp_ns, topic, TF, make(TF, transforms=[transform(stamp_ns, T, child, parent)])


def write(path, messages, compression=None):
    """A rosbag2 folder of records, in their stamps' order; returns the path."""
    writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)
    if compression:
        writer.set_compression(*compression)
    with writer:
        connections = {}
        for stamp, topic, kind, message in sorted(messages, key=lambda record: record[0]):
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, kind, typestore=STORE)
            writer.write(connections[topic], stamp, STORE.serialize_cdr(message, kind))
    return path
