"""Core types to ROS messages, and back where a node takes one; pure functions."""

from __future__ import annotations

import array
import math

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Pose
from sensor_msgs.msg import CameraInfo, Image
from stack_counter_msgs.msg import Container as ContainerMsg
from stack_counter_msgs.msg import HeightMap as HeightMapMsg
from stack_counter_msgs.msg import KeyView as KeyViewMsg
from stack_counter_msgs.msg import PosedImage, StageSeconds
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from stack_counter_msgs.msg import ViewTally as ViewTallyMsg
from std_msgs.msg import Header

from stack_counter import geometry
from stack_counter.types import (
    Container,
    HeightMap,
    Intrinsics,
    KeyView,
    StackCount,
    StackVolume,
    View,
    ViewTally,
)

_STATUS = {"ok": StackCountMsg.STATUS_OK, "degraded": StackCountMsg.STATUS_DEGRADED}


def to_time(stamp_ns: int) -> Time:
    """ROS time of a stamp in ns."""
    return Time(sec=stamp_ns // 10**9, nanosec=stamp_ns % 10**9)


def to_header(stamp_ns: int, frame_id: str) -> Header:
    """Header with that stamp (ns) and frame."""
    return Header(stamp=to_time(stamp_ns), frame_id=frame_id)


def to_pose(T: np.ndarray) -> Pose:
    """Pose of a (4, 4) transform."""
    pose = Pose()
    pose.position.x, pose.position.y, pose.position.z = (float(x) for x in T[:3, 3])
    (pose.orientation.x, pose.orientation.y, pose.orientation.z,
     pose.orientation.w) = (float(x) for x in geometry.quaternion_from_pose(T))
    return pose


def to_image(image: np.ndarray | None, encoding: str, header: Header) -> Image:
    """Image message of an array; without data for None."""
    message = Image(header=header, encoding=encoding)
    if image is not None:
        message.height, message.width = image.shape[:2]
        message.step = image[0].nbytes
        message.data = to_bytes(image)
    return message


def to_bytes(values: np.ndarray) -> array.array:
    """The bytes of an array as rclpy takes them fastest (others it copies one by one)."""
    data = array.array("B")
    data.frombytes(memoryview(np.ascontiguousarray(values)).cast("B"))
    return data


def to_camera_info(k: Intrinsics, header: Header) -> CameraInfo:
    """CameraInfo with K, D and the model."""
    info = CameraInfo(header=header, width=k.width, height=k.height,
                      distortion_model=k.distortion_model, d=list(k.distortion))
    info.k = [float(x) for x in k.K.ravel()]
    info.p = [k.fx, 0.0, k.cx, 0.0, 0.0, k.fy, k.cy, 0.0, 0.0, 0.0, 1.0, 0.0]
    info.r = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
    return info


def to_posed_image(view: View, world_frame: str, scan_id: str, part: str, unit_volume: float,
                   camera: str = "") -> PosedImage:
    """A view as the collector sends it on; `camera`: its name in the rig."""
    header = to_header(view.stamp_ns, view.camera)
    return PosedImage(
        header=header, scan_id=scan_id, part=part, unit_volume=unit_volume,
        world_frame=world_frame, camera=camera, camera_fixed=view.fixed,
        pose=to_pose(view.T_world_camera),
        camera_info=to_camera_info(view.intrinsics, header),
        color=to_image(view.color, "rgb8", header), depth=to_image(view.depth, "32FC1", header),
        labels=to_image(view.labels, "mono8", header))


def to_container(c: Container) -> ContainerMsg:
    """Container message."""
    message = ContainerMsg(kind=c.kind, pose=to_pose(c.T_world_container),
                           wall_thickness=c.wall_thickness_m,
                           floor_thickness=c.floor_thickness_m)
    inner, outer = message.inner_size, message.outer_size
    inner.x, inner.y, inner.z = c.inner_size_m
    outer.x, outer.y, outer.z = c.outer_size_m
    return message


def to_height_map(m: HeightMap | None) -> HeightMapMsg:
    """Height map message; without cells for None."""
    if m is None:
        return HeightMapMsg()
    rows, cols = m.heights.shape
    return HeightMapMsg(pose=to_pose(m.T_world_map), pitch=m.pitch, rows=rows, cols=cols,
                        heights=array.array("f", m.heights.astype(np.float32).tobytes()))


def to_key_view(view: KeyView, frame_id: str) -> KeyViewMsg:
    """Key view message."""
    header = to_header(view.stamp_ns, frame_id)
    return KeyViewMsg(
        header=header, camera_info=to_camera_info(view.intrinsics, header),
        pose=to_pose(view.T_world_camera), part_pixels=view.part_pixels,
        color=to_image(view.color, "rgb8", header), depth=to_image(view.depth, "32FC1", header),
        labels=to_image(view.labels, "mono8", header))


def to_tally(tally: ViewTally) -> ViewTallyMsg:
    """Tally message."""
    return ViewTallyMsg(received=tally.received, used=tally.used,
                        skip_reasons=list(tally.skipped),
                        skip_counts=list(tally.skipped.values()))


def to_seconds(seconds: dict[str, float]) -> StageSeconds:
    """Stage times message."""
    return StageSeconds(stages=list(seconds), seconds=list(seconds.values()))


def to_stack_volume(v: StackVolume, world_frame: str, request: PosedImage, final: bool
                    ) -> StackVolumeMsg:
    """Volume message; `request` is a posed image of the scan: its id and part are copied."""
    message = StackVolumeMsg(
        header=to_header(v.stamp_ns, world_frame), scan_id=request.scan_id, final=final,
        part=request.part, unit_volume=request.unit_volume, stack_volume=v.stack_volume,
        stack_volume_std=v.stack_volume_std, container=to_container(v.container),
        coverage=v.coverage, overfilled=v.overfilled,
        missing_cameras=list(v.missing_cameras), top=to_height_map(v.top),
        inner=to_height_map(v.inner),
        has_key_view=v.key_view is not None, views=to_tally(v.views), reasons=list(v.reasons),
        seconds=to_seconds(v.seconds))
    message.fill_level_min, message.fill_level_mean, message.fill_level_max = v.fill_level
    if v.key_view is not None:
        message.key_view = to_key_view(v.key_view, request.header.frame_id)
    return message


def to_stack_count(c: StackCount, request: StackVolumeMsg) -> StackCountMsg:
    """Count message; `request` is the volume it was counted from."""
    message = failed_count("", request)
    message.count, (message.count_low, message.count_high) = c.count, c.count_interval
    message.confidence, message.gamma, message.gamma_std = c.confidence, c.gamma, c.gamma_std
    message.unit_volume, message.estimator = c.unit_volume, c.estimator
    message.gamma_sources = list(c.gamma_shares)
    message.gamma_shares, message.counted_scans = list(c.gamma_shares.values()), c.counted_scans
    message.status, message.reasons = _STATUS[c.status], list(c.reasons)
    message.seconds = to_seconds(c.seconds)
    return message


def failed_count(error: str, request: StackVolumeMsg) -> StackCountMsg:
    """Count message of a scan that gives no count, with the reason."""
    return StackCountMsg(
        header=request.header, scan_id=request.scan_id, final=request.final, part=request.part,
        unit_volume=request.unit_volume, confidence=math.nan, gamma=math.nan, gamma_std=math.nan,
        stack_volume=request.stack_volume, stack_volume_std=request.stack_volume_std,
        container=request.container, views=request.views,
        missing_cameras=request.missing_cameras, status=StackCountMsg.STATUS_ERROR,
        reasons=request.reasons, error=error, seconds=request.seconds)
