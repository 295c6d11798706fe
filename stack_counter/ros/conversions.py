# SPDX-License-Identifier: Apache-2.0
"""Messages of `stack_counter_msgs` and the core's types: both ways of a type side by side.

A new field of a type is edited in the message, in the type and in its pair of functions here; the
test of this module fails for a field that is forgotten.
"""

from __future__ import annotations

import array
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from stack_counter_msgs.msg import Container as ContainerMsg
from stack_counter_msgs.msg import HeightMap as HeightMapMsg
from stack_counter_msgs.msg import KeyView as KeyViewMsg
from stack_counter_msgs.msg import PosedImage
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from stack_counter_msgs.msg import ViewTally as ViewTallyMsg

from stack_counter.ros.count_fields import (
    copy_filling_level,
    filling_level_of,
    from_reasons,
    from_seconds,
    from_sources,
    set_filling_level,
    set_visible_parts,
    to_reasons,
    to_seconds,
    to_sources,
    visible_parts_of,
)
from stack_counter.ros.part_fields import from_part_fields, to_part_fields
from stack_counter.ros.standard_messages import to_camera_info, to_header, to_image, to_pose
from stack_counter.ros.stated_sizes import check_image_sizes, check_map, check_volume
from stack_counter.types import (
    Container,
    HeightMap,
    KeyView,
    PartRequest,
    Reason,
    StackCount,
    StackVolume,
    View,
    ViewTally,
)
from stack_counter.views import decoding

_STATUS_NUMBERS = {"ok": StackCountMsg.STATUS_OK, "degraded": StackCountMsg.STATUS_DEGRADED,
                   "error": StackCountMsg.STATUS_ERROR}
_STATUS_NAMES = {number: name for name, number in _STATUS_NUMBERS.items()}


# --- one view ---------------------------------------------------------------------------------

def to_posed_image(view: View, world_frame: str, scan_id: str, part: PartRequest,
                   camera: str = "") -> PosedImage:
    """Returns the message of a view.

    Args:
        view: what is sent.
        world_frame: frame of `view.T_world_camera`.
        scan_id: scan that the view belongs to.
        part: that the scan is asked to be of.
        camera: name of the camera in the rig, or "".
    """
    header = to_header(view.stamp_ns, view.camera)
    return PosedImage(
        header=header, scan_id=scan_id, **to_part_fields(part),
        world_frame=world_frame, camera=camera, camera_fixed=view.fixed,
        pose=to_pose(view.T_world_camera),
        camera_info=to_camera_info(view.intrinsics, header),
        color=to_image(view.color, "rgb8", header), depth=to_image(view.depth, "32FC1", header),
        labels=to_image(view.labels, "mono8", header))


def from_posed_image(message: PosedImage) -> View:
    """Returns the view of its message.

    Raises:
        ViewError: an image cannot be decoded or is of another size than its calibration, its
            depth is empty, or the pose is none.
    """
    check_image_sizes(message)
    return View(
        stamp_ns=decoding.stamp_ns(message.header.stamp), camera=message.header.frame_id,
        intrinsics=decoding.intrinsics_of_camera_info(message.camera_info),
        T_world_camera=decoding.pose_to_matrix(message.pose), fixed=message.camera_fixed,
        color=_decode_if_any(message.color, decoding.color_to_array),
        depth=_decode_if_any(message.depth, decoding.depth_to_metres),
        labels=_decode_if_any(message.labels, decoding.labels_to_array))


def _decode_if_any(image: Any, decode: Callable[[Any], np.ndarray]) -> np.ndarray | None:
    return decode(image) if len(image.data) else None


def to_key_view(view: KeyView, frame_id: str) -> KeyViewMsg:
    """Returns the message of a key view; `frame_id` names the camera's optical frame."""
    header = to_header(view.stamp_ns, frame_id)
    return KeyViewMsg(
        header=header, camera_info=to_camera_info(view.intrinsics, header),
        pose=to_pose(view.T_world_camera), part_pixels=view.part_pixels,
        color=to_image(view.color, "rgb8", header), depth=to_image(view.depth, "32FC1", header),
        labels=to_image(view.labels, "mono8", header))


def from_key_view(message: KeyViewMsg) -> KeyView:
    """Returns the key view of its message.

    Raises:
        ViewError: an image cannot be decoded or is of another size than its calibration, its
            depth is empty, or the pose is none.
    """
    check_image_sizes(message)
    return KeyView(
        stamp_ns=decoding.stamp_ns(message.header.stamp),
        intrinsics=decoding.intrinsics_of_camera_info(message.camera_info),
        T_world_camera=decoding.pose_to_matrix(message.pose), part_pixels=message.part_pixels,
        labels=decoding.image_to_array(message.labels),
        depth=_decode_if_any(message.depth, decoding.depth_to_metres),
        color=_decode_if_any(message.color, decoding.color_to_array))


# --- the stack --------------------------------------------------------------------------------

def to_container(container: Container) -> ContainerMsg:
    """Returns the message of a container; its wall (`rings`, `wall_shape`) is not sent."""
    message = ContainerMsg(kind=container.kind, pose=to_pose(container.T_world_container),
                           wall_thickness=container.wall_thickness_m,
                           floor_thickness=container.floor_thickness_m)
    inner, outer = message.inner_size, message.outer_size
    inner.x, inner.y, inner.z = container.inner_size_m
    outer.x, outer.y, outer.z = container.outer_size_m
    return message


def from_container(message: ContainerMsg) -> Container:
    """Returns the container of its message, without its wall."""
    size = message.inner_size
    return Container(kind=message.kind, T_world_container=decoding.pose_to_matrix(message.pose),
                     inner_size_m=(size.x, size.y, size.z),
                     wall_thickness_m=message.wall_thickness,
                     floor_thickness_m=message.floor_thickness)


def to_height_map(height_map: HeightMap | None) -> HeightMapMsg:
    """Returns the message of a height map; one without cells for None."""
    if height_map is None:
        return HeightMapMsg()
    rows, cols = height_map.heights.shape
    return HeightMapMsg(pose=to_pose(height_map.T_world_map), pitch=height_map.pitch, rows=rows,
                        cols=cols, heights=array.array(
                            "f", height_map.heights.astype(np.float32).tobytes()))


def from_height_map(message: HeightMapMsg) -> HeightMap | None:
    """Returns the height map of its message; None for one without cells.

    Raises:
        ScanError: it states another number of cells than it has, or no pitch.
        ViewError: its pose is none.
    """
    if not message.rows:
        return None
    check_map(message)
    heights = np.array(message.heights, np.float32).reshape(message.rows, message.cols)
    return HeightMap(decoding.pose_to_matrix(message.pose), message.pitch, heights)


def to_tally(tally: ViewTally) -> ViewTallyMsg:
    """Returns the message of a tally."""
    return ViewTallyMsg(received=tally.received, used=tally.used,
                        skip_reasons=list(tally.skipped),
                        skip_counts=list(tally.skipped.values()))


def from_tally(message: ViewTallyMsg) -> ViewTally:
    """Returns the tally of its message."""
    return ViewTally(message.received, message.used, from_skips(message))


def from_skips(message: Any) -> dict[str, int]:
    """Returns how many views a `ViewTally` or `ScanStatus` skipped, by reason."""
    return dict(zip(message.skip_reasons, (int(n) for n in message.skip_counts)))


def to_stack_volume(volume: StackVolume, world_frame: str, request: PosedImage, final: bool
                    ) -> StackVolumeMsg:
    """Returns the message of a volume; the mesh is not sent.

    Args:
        volume: what is sent.
        world_frame: frame of the container and the maps.
        request: posed image of the scan; its scan, part and camera are copied.
        final: the scan has ended.
    """
    message = StackVolumeMsg(
        header=to_header(volume.stamp_ns, world_frame), scan_id=request.scan_id, final=final,
        **to_part_fields(from_part_fields(request)), stack_volume=volume.stack_volume,
        stack_volume_std=volume.stack_volume_std, container=to_container(volume.container),
        coverage=volume.coverage, overfilled=volume.overfilled,
        missing_cameras=list(volume.missing_cameras), top=to_height_map(volume.top),
        inner=to_height_map(volume.inner), has_key_view=volume.key_view is not None,
        views=to_tally(volume.views), reasons=to_reasons(volume.reasons),
        seconds=to_seconds(volume.seconds), region=volume.region,
        view_agreement=volume.view_agreement_m, resolution=volume.resolution_m)
    message.fill_level_min, message.fill_level_mean, message.fill_level_max = volume.fill_level
    set_filling_level(message, volume.filling_level)
    if volume.key_view is not None:
        message.key_view = to_key_view(volume.key_view, request.header.frame_id)
    return message


def from_stack_volume(message: StackVolumeMsg) -> StackVolume:
    """Returns the volume of its message, without mesh.

    Raises:
        ViewError: an image of the key view cannot be decoded, or a pose is none.
        ScanError: V, its standard deviation or a map cannot be one.
    """
    check_volume(message)
    reasons = from_reasons(message.reasons)
    return StackVolume(
        stamp_ns=decoding.stamp_ns(message.header.stamp), stack_volume=message.stack_volume,
        stack_volume_std=message.stack_volume_std, container=from_container(message.container),
        fill_level=(message.fill_level_min, message.fill_level_mean, message.fill_level_max),
        coverage=message.coverage, top=from_height_map(message.top),
        inner=from_height_map(message.inner), missing_cameras=tuple(message.missing_cameras),
        key_view=from_key_view(message.key_view) if message.has_key_view else None,
        views=from_tally(message.views), reasons=reasons, one_side=Reason.ONE_SIDE in reasons,
        seconds=from_seconds(message.seconds), region=message.region,
        view_agreement_m=message.view_agreement, resolution_m=message.resolution,
        filling_level=filling_level_of(message))


# --- the count --------------------------------------------------------------------------------

def to_stack_count(count: StackCount, request: StackVolumeMsg) -> StackCountMsg:
    """Returns the message of a count; `request` is the volume that it was counted from."""
    message = failed_count("", request)
    message.count, (message.count_low, message.count_high) = count.count, count.count_interval
    message.confidence, message.estimator = count.confidence, count.estimator
    message.gamma, message.gamma_std = count.gamma, count.gamma_std
    message.unit_volume, message.counted_scans = count.unit_volume, count.counted_scans
    message.gamma_sources = list(count.gamma_shares)
    message.gamma_shares = list(count.gamma_shares.values())
    message.status, message.reasons = _STATUS_NUMBERS[count.status], to_reasons(count.reasons)
    message.seconds = to_seconds(count.seconds)
    message.count_sources = to_sources(count.sources)
    message.net_weight = math.nan if count.net_weight_kg is None else count.net_weight_kg
    set_visible_parts(message, count.visible_parts)
    return message


def from_stack_count(message: StackCountMsg, volume: StackVolume) -> StackCount:
    """Returns the count of its message; `volume` is what it was counted from."""
    return StackCount(
        count=message.count, count_interval=(message.count_low, message.count_high),
        confidence=message.confidence, gamma=message.gamma, gamma_std=message.gamma_std,
        unit_volume=message.unit_volume, volume=volume, estimator=message.estimator,
        counted_scans=message.counted_scans,
        gamma_shares=dict(zip(message.gamma_sources, message.gamma_shares)),
        reasons=from_reasons(message.reasons), status=_STATUS_NAMES[message.status],
        seconds=from_seconds(message.seconds), sources=from_sources(message.count_sources),
        net_weight_kg=None if math.isnan(message.net_weight) else message.net_weight,
        visible_parts=visible_parts_of(message))


def failed_count(error: str, request: StackVolumeMsg) -> StackCountMsg:
    """Returns the message of a volume that gives no count, and `error`, which says why."""
    message = StackCountMsg(
        header=request.header, scan_id=request.scan_id, final=request.final, part=request.part,
        unit_volume=request.unit_volume, confidence=math.nan, gamma=math.nan, gamma_std=math.nan,
        stack_volume=request.stack_volume, stack_volume_std=request.stack_volume_std,
        container=request.container, views=request.views,
        missing_cameras=request.missing_cameras, status=StackCountMsg.STATUS_ERROR,
        reasons=request.reasons, error=error, seconds=request.seconds, region=request.region,
        view_agreement=request.view_agreement, net_weight=math.nan)
    set_visible_parts(message, None)
    copy_filling_level(message, request)
    return message
