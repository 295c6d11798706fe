# SPDX-License-Identifier: Apache-2.0
"""One scan in the forms that users have it in: by camera driver, by recorder and as a folder."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
from kits.bag_formats import FORMATS, messages_of
from kits.packed_depth import packed, png
from kits.recording_kit import (
    COLOR,
    COMPRESSED,
    DEPTH,
    FRAME,
    IMAGE,
    INFO,
    compressed,
    header,
    image,
    make,
    pose_stamped,
    records,
    scan,
    tf_record,
    write,
)

FLIP = np.diag([1.0, -1, -1, 1])  # from OpenCV's camera axes to OpenGL's


def in_form(path, name):
    """The scan as a recorder writes it with another option; returns its path."""
    path.mkdir()
    return FORMATS[name](path, messages_of(write(path / "made", records(scan()))))


def with_depth(path, change, kind=IMAGE, topic=DEPTH):
    """The scan with other messages of depth: `change(millimetres, stamp_ns)`."""
    out = []
    for stamp, name, old_kind, message in records(scan()):
        if name == DEPTH:
            pixels = np.frombuffer(message.data, np.uint16).reshape(message.height, -1)
            out.append((stamp, topic, kind, change(pixels, stamp)))
        else:
            out.append((stamp, name, old_kind, message))
    return write(path, out)


def with_color(path, encoding, encode):
    """The scan with colour in another encoding: `encode` of an (h, w, 3) RGB image."""
    out = []
    for stamp, name, kind, message in records(scan()):
        if name == COLOR:
            pixels = np.frombuffer(message.data, np.uint8).reshape(message.height, -1, 3)
            message = image(encode(pixels), encoding, stamp)
        out.append((stamp, name, kind, message))
    return write(path, out)


def under(path, namespace):
    """The scan of a driver that puts a namespace before its topics."""
    return write(path, [(stamp, f"{namespace}{topic}" if topic.startswith("/camera") else topic,
                         kind, message) for stamp, topic, kind, message in records(scan())])


def renamed(path, names, **of_info):
    """The scan with other names of topics, and other fields of the calibration."""
    return write(path, [(stamp, names.get(topic, topic), kind,
                         replace(message, **of_info) if topic == INFO else message)
                        for stamp, topic, kind, message in records(scan())])


def without_frame(path, *topics):
    """The scan of a driver whose messages on some topics name no frame."""
    return write(path, [(stamp, topic, kind, replace(message, header=replace(
        message.header, frame_id="")) if topic in topics else message)
        for stamp, topic, kind, message in records(scan())])


def of_world(path, name):
    """The scan of a robot whose TF tree has another root."""
    return write(path, [(stamp, topic, kind, replace(message, transforms=[
        replace(t, header=replace(t.header, frame_id=name)) for t in message.transforms])
        if topic == "/tf" else message) for stamp, topic, kind, message in records(scan())])


def two_views_apart(path, short, by_mm=80):
    """Two views, of which the one numbered `short` reads its depth too near."""
    views = list(scan())[:2]
    depth = views[short].depth
    views[short] = replace(views[short], depth=np.maximum(depth - by_mm / 1000, 0))
    return write(path, records(views))


def jpeg_depth(path):
    """Depth as compressed_image_transport packs it by default: lossy, of 8 bits."""
    return with_depth(path, lambda mm, stamp: packed(
        cv2.imencode(".jpg", (mm >> 2).astype(np.uint8))[1].tobytes(),
        "16UC1; jpeg compressed ", stamp, config=False), COMPRESSED, DEPTH + "/compressed")


def video(path):
    """Colour as a driver's video encoder gives it."""
    return write(path, [
        (stamp, f"{name}/compressed", COMPRESSED, packed(b"\0\0\0\1\x67\1\2\3\4", "h264", stamp,
                                                       config=False))
        if name == COLOR else (stamp, name, kind, message)
        for stamp, name, kind, message in records(scan())])


def with_few_raw_images(path):
    """Colour comes compressed, and once raw: somebody looked at it."""
    few = [record for record in records(scan()) if record[1] == COLOR][2:3]
    others = [record for record in records(scan()) if record[1] != COLOR]
    return write(path, [*others, *few, *((view.stamp_ns, f"{COLOR}/compressed", COMPRESSED,
                                          compressed(view.color, stamp_ns=view.stamp_ns))
                                         for view in scan())])


def cloud(path):
    """Depth comes as a cloud of points alone."""
    def points(mm, stamp):
        field = make("sensor_msgs/msg/PointField", name="z", offset=0, datatype=7, count=1)
        data = np.frombuffer((mm / 1000).astype(np.float32).tobytes(), np.uint8)
        return make("sensor_msgs/msg/PointCloud2", header=header(stamp), height=mm.shape[0],
                    width=mm.shape[1], fields=[field], is_bigendian=False, point_step=4,
                    row_step=4 * mm.shape[1], data=data, is_dense=False)
    return with_depth(path, points, "sensor_msgs/msg/PointCloud2", "/points")


def with_poses(path, topic, odometry=False):
    """Poses come by a topic of their own, as PoseStamped or Odometry."""
    def message(view):
        posed = pose_stamped(view.stamp_ns, view.T_world_camera)
        if not odometry:
            return posed
        zero = make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
        twist = make("geometry_msgs/msg/Twist", linear=zero, angular=zero)
        return make("nav_msgs/msg/Odometry", header=posed.header, child_frame_id=FRAME, pose=make(
            "geometry_msgs/msg/PoseWithCovariance", pose=posed.pose, covariance=np.zeros(36)),
            twist=make("geometry_msgs/msg/TwistWithCovariance", twist=twist,
                       covariance=np.zeros(36)))
    kind = "nav_msgs/msg/Odometry" if odometry else "geometry_msgs/msg/PoseStamped"
    return write(path, [*records(scan(), poses=False), *(
        (view.stamp_ns, topic, kind, message(view)) for view in scan())])


def static_on_tf(path):
    """The arm's tool moves, and the camera on it is published once, on /tf."""
    arm = [(stamp, topic, kind, replace(message, transforms=[
        replace(t, child_frame_id="tool0") for t in message.transforms])
        if topic == "/tf" else message) for stamp, topic, kind, message in records(scan())]
    return write(path, [*arm, tf_record(1, np.eye(4), parent="tool0")])


def two_parents(path):
    """The hand-eye calibration and the camera's driver name another parent of one frame."""
    found = [record for record in records(scan()) if record[1] != "/tf" or record[0] % 10**9]
    return write(path, [*found, *(tf_record(stamp + 1, np.eye(4), parent="camera_link")
                                  for stamp, topic, *_ in found if topic == "/tf")])


def upside_down(path):
    """The poses are in the base of a robot that hangs from a ceiling."""
    return write(path, records([replace(
        view, T_world_camera=FLIP @ view.T_world_camera) for view in scan()]))


def compressed_depth(path):
    """Depth as compressed_depth_image_transport packs it."""
    return with_depth(path, lambda mm, stamp: packed(
        png(mm), "16UC1; compressedDepth png", stamp), COMPRESSED, DEPTH + "/compressedDepth")


def png_depth(path):
    """Depth as compressed_image_transport packs it."""
    return with_depth(path, lambda mm, stamp: packed(
        png(mm), "16UC1; png compressed ", stamp, config=False), COMPRESSED, DEPTH + "/compressed")


def float_millimetres(path):
    """Depth as 32FC1, in millimetres instead of metres."""
    return with_depth(path, lambda mm, stamp: image(mm.astype(np.float32), "32FC1", stamp))


def signed_millimetres(path):
    """Depth as 16SC1, as some writers of point clouds have it; below 0 is invalid."""
    return with_depth(path, lambda mm, stamp: image(np.where(mm > 0, mm.astype(np.int16), -1),
                                                    "16SC1", stamp))


def double_metres(path):
    """Depth as 64FC1, as scripts with numpy write it."""
    return with_depth(path, lambda mm, stamp: image(mm * 0.001, "64FC1", stamp))


def tenth_millimetres(path):
    """Depth as 16UC1, in 0.1 mm instead of millimetres."""
    return with_depth(path, lambda mm, stamp: image(
        np.minimum(mm.astype(int) * 10, 65535).astype(np.uint16), "16UC1", stamp))


def yuyv(rgb):
    """(h, w, 2) brightness and, in turn, the two colours."""
    yuv = cv2.cvtColor(rgb, cv2.COLOR_RGB2YUV)
    pairs = yuv[..., :2].copy()
    pairs[:, 1::2, 1] = yuv[:, ::2, 2]
    return pairs


def mosaic(rgb):
    """(h, w) of a sensor behind an RGGB filter."""
    out = rgb[..., 1].copy()
    out[::2, ::2], out[1::2, 1::2] = rgb[::2, ::2, 0], rgb[1::2, 1::2, 2]
    return out


def grey16(rgb):
    """(h, w) uint16 brightness."""
    return cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.uint16) * 257


# By encoding: what the driver makes of an (h, w, 3) uint8 RGB image.
COLORS = {"yuv422_yuy2": yuyv, "yuv422": lambda rgb: yuyv(rgb)[..., ::-1], "bayer_rggb8": mosaic,
          "8UC3": lambda rgb: rgb[..., ::-1], "mono16": grey16,
          "rgb16": lambda rgb: rgb.astype(np.uint16) * 257}


def folder(path, suffix=".png", **keys):
    """A nerfstudio folder of the scan: pictures, 16-bit depth, masks of the upper third.

    Args:
        path: a new folder.
        suffix: of the pictures as transforms.json names them; the files are PNG.
        keys: of every frame; `{}` stands for the picture's name.
    """
    for name in ("images", "depths", "masks"):
        (path / name).mkdir(parents=True)
    frames = []
    for i, view in enumerate(scan()):
        mask = np.full(view.depth.shape, 255, np.uint8)
        mask[:mask.shape[0] // 3] = 0
        for name, pixels in (("images", view.color[..., ::-1]), ("masks", mask),
                             ("depths", np.round(view.depth * 1000).astype(np.uint16))):
            cv2.imwrite(str(path / f"{name}/frame_{i:05d}.png"), pixels)
        frames.append({"file_path": f"images/frame_{i:05d}{suffix}",
                       "transform_matrix": (view.T_world_camera @ FLIP).tolist(),
                       **{key: value.format(f"frame_{i:05d}") for key, value in keys.items()}})
    K = scan()[0].intrinsics
    (path / "transforms.json").write_text(json.dumps({
        "w": K.width, "h": K.height, "fl_x": K.fx, "fl_y": K.fy, "cx": K.cx, "cy": K.cy,
        "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0, "camera_model": "OPENCV", "frames": frames}))
    return path
