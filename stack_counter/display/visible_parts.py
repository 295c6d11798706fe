# SPDX-License-Identifier: Apache-2.0
"""The parts that show: in JSON, in words, and as outlines in the key view."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from stack_counter import geometry
from stack_counter.types import KeyView, PartPose, StackCount, VisiblePart

_DIGITS = 5  # of metres and quaternions in JSON: hundredths of a millimetre


def visible_parts_as_dict(parts: Sequence[VisiblePart] | None) -> dict[str, Any]:
    """Returns the fields of the JSON; null for parts that were not looked for."""
    if parts is None:
        return {"visible_count": None, "visible_parts": None}
    return {"visible_count": len(parts), "visible_parts": [
        {"position_m": np.round(part.position, _DIGITS).tolist(),
         "outline_m": np.round(part.outline[:, :2], _DIGITS).tolist(),
         "share_visible": round(part.share_visible, 3), "score": round(part.score, 3),
         "pose": part.pose and _pose_as_dict(part.pose)}
        for part in parts]}


def _pose_as_dict(pose: PartPose) -> dict[str, Any]:
    T = pose.T_world_part
    return {"position_m": np.round(T[:3, 3], _DIGITS).tolist(),
            "quaternion_xyzw": np.round(geometry.quaternion_from_pose(T), _DIGITS).tolist(),
            "fit": round(pose.fit, 3)}


def visible_text(count: StackCount) -> str:
    """Returns how many parts show, and how many are inferred, for a count that has them."""
    seen = len(count.visible_parts or ())
    return f"{seen} part{'s' if seen != 1 else ''} seen from above, " \
           f"{max(count.count - seen, 0)} inferred below them"


def outlines_in_view(parts: Sequence[VisiblePart], view: KeyView) -> list[np.ndarray]:
    """(k, 2) float64 x and y of each part's outline in a view, pixels.

    Parts that reach behind the camera are left out.
    """
    T_camera_world = geometry.inverse(view.T_world_camera)
    local = [geometry.apply(T_camera_world, part.outline) for part in parts]
    return [geometry.project(points, view.intrinsics)[0] for points in local
            if (points[:, 2] > 0).all()]
