# SPDX-License-Identifier: Apache-2.0
"""Live topics for the Foxglove app, over a WebSocket: `stack-counter view`.

A message is passed on as the bytes it came in. A topic is subscribed to only while somebody looks
at it: the nodes show a running scan only then.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass

import foxglove
import rclpy
from foxglove.websocket import ChannelView, Client, ServerListener
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.subscription import Subscription

from stack_counter.bag.message_definitions import message_definition
from stack_counter.config import CollectorConfig
from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.errors import BagError, ConfigError
from stack_counter.ros.processes import shared_memory_environment
from stack_counter.ros.qos import RELIABLE, profile_that_hears
from stack_counter.ros.security import check_security
from stack_counter.ros.standard_messages import message_type
from stack_counter.views.depth_stream import depth_camera_info_topic
from stack_counter.views.rig import load_rig


@dataclass(frozen=True)
class ViewerSettings:
    """How live topics are served; all are chosen.

    Attributes:
        discovery_period_s: seconds between two looks for topics that are new.
        backlog_messages: messages that wait for a slow client before the oldest are dropped.
    """

    discovery_period_s: float = 0.5
    backlog_messages: int = 256


SETTINGS = ViewerSettings()


def camera_topics(config: CollectorConfig) -> set[str]:
    """Returns the topics of all cameras and of what says where they are.

    Raises:
        ConfigError: the rig file that the settings name cannot be used.
    """
    topics = {"/tf", "/tf_static", config.joint_states_topic}
    for camera in load_rig(config).cameras:
        c = camera.config
        topics |= {c.color_topic, f"{c.color_topic}/compressed", c.camera_info_topic,
                   c.depth_topic, depth_camera_info_topic(c), c.labels_topic, c.pose_topic}
    return topics - {""}


class LiveTopic:
    """A topic that is subscribed to while somebody looks at it."""

    def __init__(self, node: Node, name: str, kind: str, context: foxglove.Context):
        """Offers the topic to viewers.

        Args:
            node: subscribes for it.
            name: of the topic.
            kind: type name, e.g. sensor_msgs/msg/Image.
            context: of the server.

        Raises:
            BagError: the type is not known.
        """
        schema = foxglove.Schema(name=kind, encoding="ros2msg",
                                 data=message_definition(kind).encode())
        self._channel = foxglove.Channel(name, message_encoding="cdr", schema=schema,
                                         context=context)
        self._node, self._name, self._kind = node, name, message_type(kind)
        self._clients: set[int] = set()
        self._subscription: Subscription | None = None
        self._profile = RELIABLE

    def add_client(self, client: int) -> None:
        """Somebody looks at the topic: the last messages of a latched one come once more."""
        self._clients.add(client)
        if self._subscription is None \
                or self._profile.durability == DurabilityPolicy.TRANSIENT_LOCAL:
            self._subscribe(self._matching_profile())

    def remove_client(self, client: int) -> None:
        """Somebody no longer looks at it."""
        self._clients.discard(client)
        if not self._clients:
            self._unsubscribe()

    def follow_publishers(self) -> None:
        """Subscribes anew where publishers have changed so that they would not be heard."""
        if self._subscription is not None and self._matching_profile() != self._profile:
            self._subscribe(self._matching_profile())

    def _matching_profile(self) -> QoSProfile:
        """Returns the profile for those who publish now; the last one where nobody does."""
        publishers = self._node.get_publishers_info_by_topic(self._name)
        return profile_that_hears([p.qos_profile for p in publishers]) if publishers \
            else self._profile

    def _subscribe(self, profile: QoSProfile) -> None:
        self._unsubscribe()
        self._profile = profile
        self._subscription = self._node.create_subscription(
            self._kind, self._name, self._pass_on, profile, raw=True)

    def _unsubscribe(self) -> None:
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None

    def _pass_on(self, data: bytes) -> None:
        self._channel.log(data, log_time=time.time_ns())


class Viewer(ServerListener):
    """Serves the topics that somebody publishes: this package's, its cameras' and diagnostics.

    Attributes:
        node: subscribes to them; whoever makes the viewer has it spin.
        port: on which the server listens.
    """

    def __init__(self, topics: Collection[str], host: str, port: int,
                 context: Context | None = None):
        """Starts the server.

        Args:
            topics: names to serve beside those of this package.
            host: address that the server listens on.
            port: its port; 0: one that is free.
            context: ROS context; None: the default one.

        Raises:
            ConfigError: nothing can listen there.
        """
        self._topics = {*topics, "/diagnostics"}
        self._live: dict[str, LiveTopic] = {}
        self._unknown: set[str] = set()  # topics of types without definition
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name="stack_counter", host=host, port=port, server_listener=self,
                context=self._context, message_backlog_size=SETTINGS.backlog_messages)
        except RuntimeError as error:
            raise ConfigError(f"cannot listen on {host}:{port} ({error}); expected an address of "
                              "this machine and a port that is free: --host, --port") from error
        self.port = self._server.port
        self.node = Node("viewer", namespace=NAMESPACE, context=context)
        self.node.create_timer(SETTINGS.discovery_period_s, self._look_for_topics)

    def on_subscribe(self, client: Client, channel: ChannelView) -> None:
        """Called by the server, in a thread of its own, when somebody looks at a topic."""
        self._run_in_node(lambda: self._live[channel.topic].add_client(client.id))

    def on_unsubscribe(self, client: Client, channel: ChannelView) -> None:
        """Called by the server when somebody no longer does, or is gone."""
        self._run_in_node(lambda: self._live[channel.topic].remove_client(client.id))

    def is_offered(self, topic: str) -> bool:
        """Whether clients can subscribe to a topic."""
        return topic in self._live

    def close(self) -> None:
        """Ends the server and the node."""
        self._server.stop()
        self.node.destroy_node()

    def _run_in_node(self, task: Callable[[], None]) -> None:
        """Has the thread that takes messages do something, so that it is never amid them."""
        if self.node.executor is not None:
            self.node.executor.create_task(task)

    def _look_for_topics(self) -> None:
        """Offers topics that are new, and follows the publishers of the others."""
        for name, (kind, *_) in self.node.get_topic_names_and_types():
            if name in self._live:
                self._live[name].follow_publishers()
            elif self._is_served(name) and self.node.count_publishers(name):
                try:
                    self._live[name] = LiveTopic(self.node, name, kind, self._context)
                except BagError as error:
                    self._unknown.add(name)
                    self.node.get_logger().warning(f"{name} is not shown: {error}")

    def _is_served(self, topic: str) -> bool:
        """Whether a topic is one of this package's or of those that were named."""
        ours = topic.startswith(f"{NAMESPACE}/") and "/_" not in topic  # hidden: of actions
        return (ours or topic in self._topics) and topic not in self._unknown


def view(topics: Collection[str], host: str, port: int,
         on_ready: Callable[[str, int], None]) -> int:
    """Serves live topics until SIGINT or SIGTERM; returns the exit code.

    Args:
        topics: names to serve beside those of this package.
        host: address that the server listens on.
        port: its port; 0: one that is free.
        on_ready: called with host and port once the server listens.

    Raises:
        ConfigError: nothing can listen there; security is asked for and cannot be had.
    """
    check_security()
    os.environ.update(shared_memory_environment())
    rclpy.init(args=[])  # the command's own words are not for ROS
    viewer = None
    try:
        viewer = Viewer(topics, host, port)
        on_ready(host, viewer.port)
        executor = SingleThreadedExecutor()
        executor.add_node(viewer.node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        if viewer is not None:
            viewer.close()
        rclpy.try_shutdown()
    return 0
