# SPDX-License-Identifier: Apache-2.0
"""Turns scenes with depth level whose z is not up, as of apps and tools that leave it open.

ARKit's worlds have y up, and COLMAP's have any direction up.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.bag.upright import find_upright_pose
from stack_counter.types import View


@dataclass(frozen=True)
class LevelingSettings:
    """When a scene is turned; all are chosen.

    Attributes:
        points: number of points that each of them gives, about.
        level_tilt: angle of the support up to which z counts as up, rad; a count levels as much.
        wall_tilt: angle above which what looks like the support may be a wall, rad.
        min_down: mean downward part of the unit directions of sight by z, up to which such a
            support is believed.
    """

    points: int = 500
    level_tilt: float = 0.02
    wall_tilt: float = 1.05
    min_down: float = 0.3


SETTINGS = LevelingSettings()


def find_turn(views: Iterable[View]) -> np.ndarray:
    """Finds the turn that makes the support of a scene level.

    Args:
        views: some of the scene's, with depth, in its world.

    Returns:
        (4, 4) T_upright_world; the identity where z is up, or no support shows.

    Raises:
        ViewError: reason `bad_intrinsics`.
    """
    poses, points = [], []
    for view in views:
        assert view.depth is not None  # for the type checker
        poses.append(view.T_world_camera)
        stride = max(int(np.sqrt(view.depth.size / SETTINGS.points)), 1)
        points.append(geometry.world_points(geometry.rectify(view), stride).reshape(-1, 3))
    seen = np.concatenate(points) if points else np.zeros((0, 3))
    seen = seen[np.isfinite(seen).all(axis=1)].astype(float)
    if len(seen) < SETTINGS.points:
        return np.eye(4)
    found = find_upright_pose(seen, np.array(poses))
    tilt = float(np.arccos(np.clip(found.T_upright_world[2, 2], -1, 1)))
    down = -float(np.mean([T[2, 2] for T in poses]))
    believed = tilt < SETTINGS.wall_tilt or down < SETTINGS.min_down
    if not found.support_share or tilt < SETTINGS.level_tilt or not believed:
        return np.eye(4)
    return found.T_upright_world
