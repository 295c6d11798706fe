# SPDX-License-Identifier: Apache-2.0
"""The robot that stands in some views: where it was when a picture was taken."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.types import View
from stack_counter.views.joint_states import JointStates
from stack_counter.views.robot_mask import RobotMask
from stack_counter.views.tf_buffer import TransformBuffer


@dataclass(frozen=True, eq=False)
class RobotPosture:
    """Where the robot is.

    Attributes:
        T_world_base: (4, 4) pose of its base link.
        positions: of its joints by name, rad or m.
    """

    T_world_base: np.ndarray
    positions: dict[str, float]


class Robot:
    """A robot's model and joint states.

    Attributes:
        joints: takes the messages of the joint states.
    """

    def __init__(self, config: CollectorConfig):
        """Reads the URDF that the settings name.

        Raises:
            ConfigError: it cannot be used.
        """
        self._mask = RobotMask(Path(config.robot_description_file).expanduser())
        self._world_frame = config.world_frame
        self.joints = JointStates(self._mask.joint_names, config.joint_states_topic,
                                  config.tf_max_gap_s)

    def is_ready(self, stamp_ns: int, transforms: TransformBuffer) -> bool:
        """Tells whether later messages cannot change where the robot is at a stamp."""
        return self.joints.is_ready(stamp_ns) and (
            self._mask.has_link(self._world_frame)
            or transforms.is_ready(self._world_frame, self._mask.base_link, stamp_ns))

    def posture_at(self, stamp_ns: int, transforms: TransformBuffer) -> RobotPosture:
        """Where the robot is at a stamp: by its own model if that has the world frame, else by TF.

        Raises:
            ViewError: reason `no_joint_state`, `no_tf` or `tf_loop`.
        """
        positions = self.joints.positions_at(stamp_ns)
        if self._mask.has_link(self._world_frame):
            return RobotPosture(geometry.inverse(self._mask.link_pose(
                self._world_frame, positions)), positions)
        T, _ = transforms.lookup(self._world_frame, self._mask.base_link, stamp_ns)
        return RobotPosture(T, positions)

    def leave_out_of(self, view: View, posture: RobotPosture) -> View:
        """The view, rectified, without depth where the robot is.

        Raises:
            ViewError: the view shows that the robot is elsewhere (`robot_misplaced`).
        """
        view = geometry.rectify(view)
        return replace(view, depth=self._mask.depth_without_robot(
            view, posture.T_world_base, posture.positions))
