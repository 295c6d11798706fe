# SPDX-License-Identifier: Apache-2.0
"""The collector's subscriptions: camera topics and TF, handed to the assembler of views."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from tf2_msgs.msg import TFMessage

from stack_counter.ros.diagnostics import WARN, Rate
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import RELIABLE
from stack_counter.views.decoding import stamp_ns
from stack_counter.views.rig_assembler import RigAssembler

_SILENT_AFTER_S = 2.0  # an operator should look
_SENSOR_DEPTH, _TF_DEPTH, _STATIC_TF_DEPTH = 30, 1000, 100
_TAKEN_BETWEEN_SCANS = ("info", "depth_info", "pose", "joints")
_OPTIONAL = ("depth_info",)  # aligned depth needs none of its own


class CameraTopics:
    """Subscribes to what a rig's cameras and TF publish.

    Attributes:
        message_since_tick: a camera's message was handled; whoever reads it sets it back.
    """

    def __init__(self, node: ManagedNode, assembler: RigAssembler, reliable: bool,
                 is_taking: Callable[[], bool], on_data: Callable[[], None]):
        """Subscribes.

        Args:
            node: subscribes for it.
            assembler: takes the messages.
            reliable: cameras are asked for reliable delivery.
            is_taking: tells whether images are wanted now.
            on_data: called after every message that was taken.
        """
        self._node, self._assembler = node, assembler
        self._is_taking, self._on_data = is_taking, on_data
        self._rates: dict[str, Rate] = {}
        self._tf_rate = Rate()
        self._inputs: list[Subscription] = []
        self.message_since_tick = False
        self._subscribe_to_cameras(reliable)
        self._subscribe_to_tf()

    @property
    def unmatched(self) -> list[str]:
        """Topics that nobody publishes yet, as far as the readers themselves know."""
        return [s.topic_name for s in self._inputs if not s.get_publisher_count()]

    def silence_warnings(self) -> list[tuple[bytes, str]]:
        """Names cameras and TF that are silent."""
        lines = [(WARN, f"no image on {topic} for {rate.silent_s:.0f} s")
                 for topic, rate in self._rates.items() if rate.silent_s > _SILENT_AFTER_S]
        if self._assembler.needs_tf and self._assembler.waiting \
                and self._tf_rate.silent_s > _SILENT_AFTER_S:
            lines.append((WARN, f"no /tf for {self._tf_rate.silent_s:.0f} s and images wait for "
                                "it"))
        return lines

    def status_values(self) -> Mapping[str, object]:
        """Returns rates and latencies by topic."""
        return {
            **{f"{topic} Hz": rate.hz for topic, rate in self._rates.items()},
            **{f"{topic} latency s": rate.latency_s for topic, rate in self._rates.items()},
            "tf Hz": self._tf_rate.hz, "tf age s": self._tf_rate.silent_s,
            "images waiting for partners": self._assembler.waiting}

    def _subscribe_to_cameras(self, reliable: bool) -> None:
        sensor = QoSProfile(depth=_SENSOR_DEPTH, reliability=ReliabilityPolicy.RELIABLE
                            if reliable else ReliabilityPolicy.BEST_EFFORT)
        for topic, handlers in self._assembler.topic_handlers().items():
            content = handlers[0][0]
            kinds = {"color": CompressedImage if topic.endswith("/compressed") else Image,
                     "info": CameraInfo, "depth_info": CameraInfo, "pose": PoseStamped,
                     "joints": JointState}
            subscription = self._node.subscribe(
                kinds.get(content, Image), topic, self._handler_of(topic, handlers),
                {"pose": RELIABLE, "joints": QoSProfile(depth=_TF_DEPTH)}.get(content, sensor))
            if content not in _OPTIONAL:
                self._inputs.append(subscription)

    def _subscribe_to_tf(self) -> None:
        topics = self._assembler.tf_topics()
        if "/tf" in topics:
            self._inputs.append(self._node.subscribe(
                TFMessage, "/tf", lambda m: self._on_tf(m, False), QoSProfile(depth=_TF_DEPTH)))
        if "/tf_static" in topics:
            self._node.subscribe(
                TFMessage, "/tf_static", lambda m: self._on_tf(m, True),
                QoSProfile(depth=_STATIC_TF_DEPTH, durability=DurabilityPolicy.TRANSIENT_LOCAL))

    def _handler_of(self, topic: str, handlers: list[tuple[str, Callable[[Any], None]]]
                    ) -> Callable[[Any], None]:
        content = handlers[0][0]
        rate = self._rates.setdefault(topic, Rate()) if content == "color" else Rate()

        def handle(message: Any) -> None:
            rate.tick(self._age_s(message.header))
            self.message_since_tick |= content != "joints"
            if self._is_taking() or content in _TAKEN_BETWEEN_SCANS:
                for _, add in handlers:
                    add(message)
                self._on_data()
        return handle

    def _on_tf(self, message: TFMessage, static: bool) -> None:
        for transform in message.transforms:
            self._assembler.add_transform(transform, static)
            if not static:
                self._tf_rate.tick(self._age_s(transform.header))
        self._on_data()

    def _age_s(self, header: Any) -> float:
        return (self._node.get_clock().now().nanoseconds - stamp_ns(header.stamp)) * 1e-9
