# SPDX-License-Identifier: Apache-2.0
"""The assemblers of all cameras of a rig as one."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any

from stack_counter.types import View, ViewTally
from stack_counter.views.assembler import ViewAssembler
from stack_counter.views.color_transport import transport_topic
from stack_counter.views.depth_stream import depth_camera_info_topic
from stack_counter.views.rig import Rig
from stack_counter.views.robot import Robot


class RigAssembler:
    """Assembles the views of all cameras.

    Attributes:
        rig: the cameras.
        assemblers: one for each camera, by the camera's name.
    """

    def __init__(self, rig: Rig, live: bool = True):
        """Makes assemblers without images.

        Args:
            rig: the cameras.
            live: messages that stay away are given up after a time; see `ViewAssembler`.

        Raises:
            ConfigError: the URDF that the settings name cannot be used.
        """
        self.rig = rig
        config = rig.cameras[0].config  # all have the same robot
        self._robot = Robot(config) if config.robot_description_file else None
        self.assemblers = {c.name: ViewAssembler(c.config, live, c.T_world_camera, c.frame,
                                                 self._robot)
                   for c in rig.cameras}

    def start(self) -> None:
        """Begins a scan: forgets images and tally, keeps transforms and calibration."""
        for assembler in self.assemblers.values():
            assembler.start()

    @property
    def tally(self) -> ViewTally:
        """Number of images received, views accepted, and images skipped by reason, in all."""
        tallies = [a.tally for a in self.assemblers.values()]
        skipped: Counter[str] = sum((Counter(t.skipped) for t in tallies), Counter())
        return ViewTally(sum(t.received for t in tallies), sum(t.used for t in tallies),
                         dict(skipped))

    @property
    def waiting(self) -> int:
        """Number of images that wait for their partners, calibration or pose."""
        return sum(a.waiting for a in self.assemblers.values())

    @property
    def last_errors(self) -> list[str]:
        """The last error's line for each reason and camera."""
        return [f"{name}: {line}" if name else line for name, a in self.assemblers.items()
                for line in a.last_error.values()]

    @property
    def notes(self) -> list[str]:
        """What had to be assumed of the cameras' messages, a line each."""
        return [line for a in self.assemblers.values() for line in a.notes]

    def add_transform(self, message: Any, static: bool) -> None:
        """Takes a `TransformStamped` of /tf or /tf_static."""
        for assembler in self.assemblers.values():
            assembler.add_transform(message, static)

    def topic_handlers(self) -> dict[str, list[tuple[str, Callable[[Any], None]]]]:
        """Returns the handlers of each topic's messages.

        Returns:
            By topic, for each camera that needs it: its content (`color`, `info`, `depth`,
            `depth_info`, `labels`, `pose` or `joints`) and the method that takes a message.
        """
        handlers: dict[str, list[tuple[str, Callable[[Any], None]]]] = {}
        for camera in self.rig.cameras:
            c, a = camera.config, self.assemblers[camera.name]
            wanted = [(transport_topic(c.color_topic, c.color_transport), "color", a.add_color),
                      (c.camera_info_topic, "info", a.add_camera_info),
                      (c.depth_topic, "depth", a.add_depth),
                      (depth_camera_info_topic(c), "depth_info", a.add_depth_camera_info),
                      (c.labels_topic, "labels", a.add_labels)]
            if c.pose_source == "topic" and camera.T_world_camera is None:
                wanted.append((c.pose_topic, "pose", a.add_pose))
            for topic, content, handler in wanted:
                if topic:
                    handlers.setdefault(topic, []).append((content, handler))
        if self._robot is not None:
            topic = self.rig.cameras[0].config.joint_states_topic
            handlers[topic] = [("joints", self._robot.joints.add_message)]
        return handlers

    def color_topics(self) -> list[str]:
        """Returns the colour topics of all cameras."""
        return [topic for topic, handlers in self.topic_handlers().items()
                if handlers[0][0] == "color"]

    def tf_topics(self) -> list[str]:
        """Returns the topics of transforms: static ones may say where a depth camera is."""
        needs_static = self.needs_tf or any(c.config.depth_topic for c in self.rig.cameras)
        return ["/tf"] * self.needs_tf + ["/tf_static"] * needs_static

    @property
    def needs_tf(self) -> bool:
        """Whether the pose of some camera, or of the robot, comes from TF."""
        return self._robot is not None or any(
            c.T_world_camera is None and c.config.pose_source == "tf" for c in self.rig.cameras)

    def poll(self) -> list[tuple[str, View]]:
        """Returns the views that are complete now, with their cameras' names."""
        return [(name, view) for name, a in self.assemblers.items() for view in a.poll()]

    def flush(self) -> list[tuple[str, View]]:
        """Decides all images that wait, as at the end of a scan or bag; returns their views."""
        return [(name, view) for name, a in self.assemblers.items() for view in a.flush()]

