"""Messages of `stack_counter_msgs` to core types, by attribute names alone (see `messages`)."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from stack_counter.types import (
    Container,
    HeightMap,
    KeyView,
    StackCount,
    StackVolume,
    View,
    ViewTally,
)
from stack_counter.views import decoding

_STATUS = ("ok", "degraded", "error")  # by the number in StackCount.status


def _decoded(image: Any, decode: Callable[[Any], np.ndarray]) -> np.ndarray | None:
    return decode(image) if len(image.data) else None


def from_posed_image(message: Any) -> View:
    """View of a `PosedImage`.

    Raises:
        ViewError: any of the reasons above.
    """
    return View(
        stamp_ns=decoding.stamp_ns(message.header.stamp), camera=message.header.frame_id,
        intrinsics=decoding.camera_info_to_intrinsics(message.camera_info),
        T_world_camera=decoding.pose_to_matrix(message.pose), fixed=message.camera_fixed,
        color=_decoded(message.color, decoding.color_to_array),
        depth=_decoded(message.depth, decoding.depth_to_metres),
        labels=_decoded(message.labels, decoding.labels_to_array))


def from_container(message: Any) -> Container:
    """Container of its message."""
    size = message.inner_size
    return Container(message.kind, decoding.pose_to_matrix(message.pose), (size.x, size.y, size.z),
                     message.wall_thickness, message.floor_thickness)


def from_height_map(message: Any) -> HeightMap | None:
    """Height map of its message; None without cells."""
    if not message.rows:
        return None
    heights = np.array(message.heights, np.float32).reshape(message.rows, message.cols)
    return HeightMap(decoding.pose_to_matrix(message.pose), message.pitch, heights)


def from_key_view(message: Any) -> KeyView:
    """Key view of its message."""
    return KeyView(
        decoding.stamp_ns(message.header.stamp),
        decoding.camera_info_to_intrinsics(message.camera_info),
        decoding.pose_to_matrix(message.pose), message.part_pixels,
        decoding.image_to_array(message.labels),
        _decoded(message.depth, decoding.depth_to_metres),
        _decoded(message.color, decoding.color_to_array))


def from_tally(message: Any) -> ViewTally:
    """Tally of its message."""
    return ViewTally(message.received, message.used,
                     dict(zip(message.skip_reasons, (int(n) for n in message.skip_counts))))


def from_stack_volume(message: Any) -> StackVolume:
    """Volume of its message; the mesh is not sent."""
    return StackVolume(
        stamp_ns=decoding.stamp_ns(message.header.stamp), stack_volume=message.stack_volume,
        stack_volume_std=message.stack_volume_std, container=from_container(message.container),
        fill_level=(message.fill_level_min, message.fill_level_mean, message.fill_level_max),
        coverage=message.coverage, top=from_height_map(message.top),
        inner=from_height_map(message.inner), missing_cameras=tuple(message.missing_cameras),
        key_view=from_key_view(message.key_view) if message.has_key_view else None,
        views=from_tally(message.views), reasons=tuple(message.reasons),
        seconds=dict(zip(message.seconds.stages, message.seconds.seconds)))


def from_stack_count(message: Any, volume: Any) -> StackCount:
    """Count of its message and the volume that it was counted from."""
    return StackCount(
        count=message.count, count_interval=(message.count_low, message.count_high),
        confidence=message.confidence, gamma=message.gamma, gamma_std=message.gamma_std,
        unit_volume=message.unit_volume, volume=from_stack_volume(volume),
        estimator=message.estimator, counted_scans=message.counted_scans,
        gamma_shares=dict(zip(message.gamma_sources, message.gamma_shares)),
        reasons=tuple(message.reasons),
        status=_STATUS[message.status],
        seconds=dict(zip(message.seconds.stages, message.seconds.seconds)))
