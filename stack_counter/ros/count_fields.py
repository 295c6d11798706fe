# SPDX-License-Identifier: Apache-2.0
"""What volumes and counts say besides their numbers: reasons, times, filling level, visible parts.

`StackVolume` and `StackCount` both have the fields of the first three.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import TypeAlias

import numpy as np
from geometry_msgs.msg import Point, Point32, Polygon
from stack_counter_msgs.msg import CellFillingLevel as CellMsg
from stack_counter_msgs.msg import GridSize, Rectangle, StageSeconds, VisibleParts
from stack_counter_msgs.msg import RangeValue as RangeMsg
from stack_counter_msgs.msg import SourceCount as SourceCountMsg
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as StackVolumeMsg
from stack_counter_msgs.msg import VisiblePart as VisiblePartMsg

from stack_counter.ros.standard_messages import to_pose
from stack_counter.types import (
    CellFillingLevel,
    FillingLevel,
    PartPose,
    RangeValue,
    Reason,
    SourceCount,
    VisiblePart,
)
from stack_counter.views.decoding import pose_to_matrix

_NOT_LOOKED_FOR = -1  # visible_count where there are none because nobody looked

WithFillingLevel: TypeAlias = "StackCountMsg | StackVolumeMsg"


def to_reasons(reasons: Iterable[Reason]) -> list[str]:
    """Returns the slugs of reasons."""
    return [reason.value for reason in reasons]


def from_reasons(slugs: Iterable[str]) -> tuple[Reason, ...]:
    """Returns the reasons of slugs; one that this release does not know keeps its slug."""
    return tuple(Reason(slug) for slug in slugs)


def to_seconds(seconds: dict[str, float]) -> StageSeconds:
    """Returns the message of the time spent by stage, s."""
    return StageSeconds(stages=list(seconds), seconds=list(seconds.values()))


def from_seconds(message: StageSeconds) -> dict[str, float]:
    """Returns the time spent by stage, s, of its message."""
    return dict(zip(message.stages, message.seconds))


def set_filling_level(message: WithFillingLevel, level: FillingLevel | None) -> None:
    """Sets the fields of the filling level; they keep zeros where there is none."""
    if level is None:
        return
    message.overall_filling_level = _to_cell(level.overall)
    message.cells_filling_levels = [_to_cell(cell) for cell in level.cells]
    x, y = level.cell_count
    message.filling_level_cell_count = GridSize(x=x, y=y)


def copy_filling_level(message: StackCountMsg, volume: StackVolumeMsg) -> None:
    """Gives a count the filling level of the volume that it was counted from."""
    message.overfilled = volume.overfilled
    message.overall_filling_level = volume.overall_filling_level
    message.cells_filling_levels = volume.cells_filling_levels
    message.filling_level_cell_count = volume.filling_level_cell_count


def filling_level_of(message: WithFillingLevel) -> FillingLevel | None:
    """Returns the filling level of a message; None where it has no cells."""
    count = message.filling_level_cell_count
    if not count.x:
        return None
    return FillingLevel(_from_cell(message.overall_filling_level),
                        tuple(_from_cell(cell) for cell in message.cells_filling_levels),
                        (count.x, count.y))


def _to_cell(cell: CellFillingLevel) -> CellMsg:
    (width, length), (x, y, z) = cell.cell_size, cell.cell_position
    return CellMsg(cell_size=Rectangle(x=width, y=length), cell_position=Point(x=x, y=y, z=z),
                   level_in_percent=_to_range(cell.level_in_percent),
                   level_free_in_meters=_to_range(cell.level_free_in_meters),
                   coverage=cell.coverage)


def _from_cell(message: CellMsg) -> CellFillingLevel:
    size, position = message.cell_size, message.cell_position
    return CellFillingLevel((size.x, size.y), (position.x, position.y, position.z),
                            _from_range(message.level_in_percent),
                            _from_range(message.level_free_in_meters), message.coverage)


def _to_range(value: RangeValue) -> RangeMsg:
    return RangeMsg(min=value.min, max=value.max, mean=value.mean)


def _from_range(message: RangeMsg) -> RangeValue:
    return RangeValue(message.min, message.max, message.mean)


def to_sources(sources: tuple[SourceCount, ...]) -> list[SourceCountMsg]:
    """Returns the messages of what each source counts."""
    return [SourceCountMsg(source=s.source, count=s.count, count_low=s.count_interval[0],
                           count_high=s.count_interval[1], share=s.share) for s in sources]


def from_sources(messages: list[SourceCountMsg]) -> tuple[SourceCount, ...]:
    """Returns what each source counts, of its messages."""
    return tuple(SourceCount(m.source, m.count, (m.count_low, m.count_high), m.share)
                 for m in messages)


def set_visible_parts(message: StackCountMsg, parts: tuple[VisiblePart, ...] | None) -> None:
    """Sets the fields of the parts that show; None: they were not looked for."""
    message.visible_count = _NOT_LOOKED_FOR if parts is None else len(parts)
    message.visible_parts = [_to_visible_part(part, i) for i, part in enumerate(parts or ())]


def visible_parts_of(message: StackCountMsg) -> tuple[VisiblePart, ...] | None:
    """Returns the parts that show, of a message; None if they were not looked for."""
    if message.visible_count == _NOT_LOOKED_FOR:
        return None
    return tuple(map(_from_visible_part, message.visible_parts))


def to_visible_parts(count: StackCountMsg) -> VisibleParts:
    """Returns the message of the topic `visible_parts` of a count for which they were found."""
    return VisibleParts(header=count.header, scan_id=count.scan_id, region=count.region,
                        final=count.final, part=count.part, parts=count.visible_parts)


def _to_visible_part(part: VisiblePart, number: int) -> VisiblePartMsg:
    x, y, z = part.position.tolist()
    width, length, _ = np.ptp(part.outline, axis=0).tolist()
    message = VisiblePartMsg(
        id=str(number), score=part.score, position=Point(x=x, y=y, z=z),
        size=Rectangle(x=width, y=length), share_visible=part.share_visible,
        outline=Polygon(points=[Point32(x=a, y=b, z=c) for a, b, c in part.outline.tolist()]))
    if part.pose is not None:
        message.has_pose, message.pose_fit = True, part.pose.fit
        message.pose = to_pose(part.pose.T_world_part)
    return message


def _from_visible_part(message: VisiblePartMsg) -> VisiblePart:
    position = message.position
    outline = np.array([[p.x, p.y, p.z] for p in message.outline.points]).reshape(-1, 3)
    pose = PartPose(pose_to_matrix(message.pose), message.pose_fit) if message.has_pose else None
    return VisiblePart(np.array([position.x, position.y, position.z]), outline,
                       message.share_visible, message.score, pose)
