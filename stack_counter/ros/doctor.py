# SPDX-License-Identifier: Apache-2.0
"""Why the live graph gives no count: `stack-counter doctor`."""

from __future__ import annotations

import os
import time
from dataclasses import dataclass

from rclpy.context import Context
from rclpy.qos import QoSProfile, ReliabilityPolicy
from rclpy.serialization import deserialize_message

from stack_counter.bag.camera_topics import fit_rig_to_bag, missing_depth_line
from stack_counter.bag.doctor import camera_finding
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError
from stack_counter.ros.graph_findings import (
    COLLECTOR,
    Ends,
    clock_findings,
    node_findings,
    qos_findings,
)
from stack_counter.ros.node_states import GraphWatcher, ros_of_a_command
from stack_counter.ros.processes import NODES
from stack_counter.ros.qos import profile_that_hears
from stack_counter.ros.standard_messages import message_type
from stack_counter.views.checkup.checkup import Checkup
from stack_counter.views.checkup.diagnosis import diagnose
from stack_counter.views.checkup.findings import Finding
from stack_counter.views.checkup.summary import summary_lines
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


@dataclass(frozen=True)
class DoctorSettings:
    """How long the graph is looked at; all are chosen, some seconds in all.

    Attributes:
        discovery_s: until nodes and topics are known, seconds.
        margin_s: before and after the colour images are taken, in which only their partners
            are, seconds.
        listen_s: in which colour images are taken, seconds.
    """

    discovery_s: float = 2.0
    margin_s: float = 0.7
    listen_s: float = 4.0


SETTINGS = DoctorSettings()


class GraphDoctor(GraphWatcher):
    """A node that looks at what is published.

    Attributes:
        node: the node.
    """

    def __init__(self, context: Context | None = None):
        """Makes the node. `context`: the ROS context; None: the default one."""
        super().__init__("doctor", context)
        self._takes_color = False

    def examine(self, config: Config) -> tuple[list[str], list[Finding]]:
        """What comes, a line each, and what is wrong.

        Raises:
            ConfigError: the rig file cannot be used.
        """
        self.spin(SETTINGS.discovery_s)
        states = {name: self.state_of(name) for name in NODES}
        topics = self._published_topics()
        lines = [f"graph    ROS domain {os.environ.get('ROS_DOMAIN_ID', 0)}, {len(topics)} topics",
                 "nodes    " + ", ".join(f"{name} {state}" for name, state in states.items())]
        try:
            rig = fit_rig_to_bag(load_rig(config.collector), topics)
        except BagError as error:
            said = BagError(str(error).replace("the bag", "the graph"))
            return lines, [camera_finding(topics, said), *node_findings(states)]
        check = Checkup(RigAssembler(rig, live=False))
        self._listen(check, set(topics))
        lines += summary_lines(check, SETTINGS.listen_s, lambda stream: len(stream.stamps))
        # One view is enough: the camera may stand still before a scan.
        findings = diagnose(check, 1, config.reconstructor,
                            missing_depth_line(config.collector, rig, topics))
        if "/clock" not in topics:
            findings += clock_findings(check)
        return lines, [*findings, *self._qos_findings(check, config.collector),
                       *node_findings(states)]

    def _published_topics(self) -> dict[str, tuple[str, int]]:
        """Type name and number of publishers by topic."""
        counts = {name: (kinds[0], self.node.count_publishers(name))
                  for name, kinds in self.node.get_topic_names_and_types()}
        return {name: held for name, held in counts.items() if held[1]}

    def _listen(self, check: Checkup, published: set[str]) -> None:
        """Takes messages for some seconds; colour images so that their partners come as well."""
        for topic in check.topics:
            if topic in published:
                self._subscribe(check, topic)
        self.spin(SETTINGS.margin_s)
        self._takes_color = True
        self.spin(SETTINGS.listen_s)
        self._takes_color = False
        self.spin(SETTINGS.margin_s)
        check.finish()

    def _subscribe(self, check: Checkup, topic: str) -> None:
        """Has the messages of a topic noted, whatever quality of service they come with."""
        kinds = dict(self.node.get_topic_names_and_types())
        kind = message_type(kinds[topic][0])
        is_color = topic in check.streams and check.streams[topic].content == "color"
        profiles = [p.qos_profile for p in self.node.get_publishers_info_by_topic(topic)]

        def take(data: bytes) -> None:
            if self._takes_color or not is_color:
                check.add(topic, deserialize_message(data, kind), len(data), time.time_ns())

        self.node.create_subscription(kind, topic, take, profile_that_hears(profiles), raw=True)

    def _qos_findings(self, check: Checkup, config: CollectorConfig) -> list[Finding]:
        """Who does not hear the cameras and TF; without a collector, one of these settings."""
        found: dict[str, tuple[Ends, Ends]] = {}
        for topic in check.topics:
            publishers, subscribers = (
                [(f"{end.node_namespace.rstrip('/')}/{end.node_name}", end.qos_profile)
                 for end in ends(topic)] for ends in (self.node.get_publishers_info_by_topic,
                                                      self.node.get_subscriptions_info_by_topic))
            if COLLECTOR not in dict(subscribers) and topic in check.streams:
                subscribers.append((COLLECTOR, QoSProfile(
                    depth=1, reliability=ReliabilityPolicy.RELIABLE if config.reliable
                    else ReliabilityPolicy.BEST_EFFORT)))
            found[topic] = publishers, subscribers
        return qos_findings(found)


def examine_graph(config: Config) -> tuple[list[str], list[Finding]]:
    """What comes on the live graph within some seconds, a line each, and what is wrong.

    Raises:
        ConfigError: the rig file cannot be used; security is asked for and cannot be had.
    """
    with ros_of_a_command():
        doctor = GraphDoctor()
        try:
            return doctor.examine(config)
        finally:
            doctor.close()
