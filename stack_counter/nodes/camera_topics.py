# SPDX-License-Identifier: Apache-2.0
"""The collector's subscriptions: camera topics and TF, handed to the assembler of views."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from geometry_msgs.msg import PoseStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription
from rclpy.task import Future
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, JointState
from tf2_msgs.msg import TFMessage

from stack_counter.ros.diagnostics import WARN, Rate, data_age_s
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import RELIABLE
from stack_counter.views.camera_search import find_cameras, lines_to_paste
from stack_counter.views.color_transport import (
    AUTO,
    color_topics,
    depth_topics,
    is_compressed,
    wrong_transport_line,
)
from stack_counter.views.decoding import stamp_ns
from stack_counter.views.rig_assembler import RigAssembler

_SILENT_AFTER_S = 2.0  # an operator should look
# A stop waits until no image was handled for some ticks in a row, but not for ever: cameras that
# run freely always send some. With 20 ms of quiet the last image was missed on a busy machine.
_QUEUE_TICK_S, _QUEUE_QUIET_TICKS, _QUEUE_MAX_TICKS = 0.02, 5, 25
_SENSOR_DEPTH, _TF_DEPTH, _STATIC_TF_DEPTH = 30, 1000, 100
_TAKEN_BETWEEN_SCANS = ("info", "depth_info", "pose", "joints")
_OPTIONAL = ("depth_info",)  # aligned depth needs none of its own


@dataclass(eq=False)
class _ImageInput:
    """Images that come raw or, on a topic beside it, compressed.

    Attributes:
        topics: on which they may come, the best first.
        handlers: take the messages, with their content.
        topic: on which they are taken now; empty before the first subscription.
        subscription: to it.
    """

    topics: list[str]
    handlers: list[tuple[str, Callable[[Any], None]]]
    topic: str = ""
    subscription: Subscription | None = None


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
        self._sensor_qos = QoSProfile(depth=_SENSOR_DEPTH, reliability=ReliabilityPolicy.RELIABLE
                                      if reliable else ReliabilityPolicy.BEST_EFFORT)
        self._is_taking, self._on_data = is_taking, on_data
        self._rates: dict[str, Rate] = {}
        self._tf_rate = Rate()
        self._inputs: list[Subscription] = []
        self._rig, self._images = assembler.rig, list[_ImageInput]()
        self.message_since_tick = False
        self._handled = 0  # number of messages of cameras
        self._subscribe_to_cameras()
        self._subscribe_to_tf()

    async def handle_waiting_messages(self) -> None:
        """Returns once the messages that wait in this process's own queues are handled.

        The middleware hands over one message of each topic at a time, and then a request: a stop
        would overtake the images that were sent before it.
        """
        handled, ticks, quiet_ticks, is_done = self._handled, 0, 0, Future()

        def count_tick() -> None:
            nonlocal handled, ticks, quiet_ticks
            quiet_ticks = quiet_ticks + 1 if handled == self._handled else 0
            handled, ticks = self._handled, ticks + 1
            if quiet_ticks >= _QUEUE_QUIET_TICKS or ticks >= _QUEUE_MAX_TICKS:
                is_done.set_result(None)

        timer = self._node.create_timer(_QUEUE_TICK_S, count_tick, clock=self._node.steady)
        try:
            await is_done
        finally:
            self._node.destroy_timer(timer)

    @property
    def unmatched(self) -> list[str]:
        """Topics that nobody publishes yet, as far as the readers themselves know."""
        return [s.topic_name for s in self._inputs if not s.get_publisher_count()]

    def follow_publishers(self) -> None:
        """Takes images whose transport is not set by the one that is published."""
        for image in self._images:
            published = next(filter(self._count_publishers, image.topics), image.topic)
            if published != image.topic:
                self._subscribe_to_images(image, published)

    def problems(self) -> list[str]:
        """Names colour images that are published otherwise, or elsewhere, than is set."""
        lines = [wrong_transport_line(c.config.color_topic, c.config.color_transport,
                                      self._count_publishers) for c in self._rig.cameras]
        return [line for line in (*lines, self._other_cameras_line()) if line]

    def _other_cameras_line(self) -> str:
        """Names the cameras that are published where the one that is set is not; "" if it is."""
        config = self._rig.cameras[0].config
        topics = color_topics(config.color_topic, AUTO)
        if config.rig or any(map(self._count_publishers, topics)):
            return ""
        published = {name: kinds[0] for name, kinds in self._node.get_topic_names_and_types()
                     if self._count_publishers(name)}
        cameras = find_cameras(published)
        return f"{config.color_topic} has no publisher; set for the collector " \
               f"{lines_to_paste(cameras)}" if cameras else ""

    def _count_publishers(self, topic: str) -> int:
        return self._node.count_publishers(self._node.resolve_topic_name(topic))

    def silence_warnings(self) -> list[tuple[bytes, str]]:
        """Names cameras and TF that are silent."""
        lines = [(WARN, f"no image on {self._node.resolve_topic_name(topic)} for "
                        f"{rate.silent_s:.0f} s")
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

    def _subscribe_to_cameras(self) -> None:
        kinds = {"info": CameraInfo, "depth_info": CameraInfo, "pose": PoseStamped,
                 "joints": JointState}
        profiles = {"pose": RELIABLE, "joints": QoSProfile(depth=_TF_DEPTH)}
        configs = [camera.config for camera in self._rig.cameras]
        transports = {topics[0]: topics for c in configs for topics in (
            color_topics(c.color_topic, c.color_transport), depth_topics(c.depth_topic))}
        for topic, handlers in self._assembler.topic_handlers().items():
            content = handlers[0][0]
            if content in ("color", "depth"):
                self._images.append(_ImageInput(transports[topic], handlers))
                self._subscribe_to_images(self._images[-1], topic)
                continue
            subscription = self._node.subscribe(
                kinds.get(content, Image), topic, self._handler_of(topic, handlers),
                profiles.get(content, self._sensor_qos))
            if content not in _OPTIONAL:
                self._inputs.append(subscription)

    def _subscribe_to_images(self, image: _ImageInput, topic: str) -> None:
        """Takes images by a topic, and no longer by the one before."""
        if image.subscription is not None:
            self._node.get_logger().info(f"{image.handlers[0][0]} images come on {topic}")
            self._rates.pop(image.topic, None)
            self._inputs.remove(image.subscription)
            self._node.destroy_subscription(image.subscription)
        image.topic = topic
        image.subscription = self._node.subscribe(
            CompressedImage if is_compressed(topic) else Image, topic,
            self._handler_of(topic, image.handlers), self._sensor_qos)
        self._inputs.append(image.subscription)

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
            self._handled += content != "joints"
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
        return data_age_s(self._node.get_clock().now().nanoseconds, stamp_ns(header.stamp))
