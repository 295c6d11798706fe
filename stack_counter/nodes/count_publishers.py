# SPDX-License-Identifier: Apache-2.0
"""The topics that counts go out on: `result` and `running_count`, and `count` of old."""

from __future__ import annotations

from rclpy.publisher import Publisher
from stack_counter_msgs.msg import StackCount

from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import FINAL_TOPICS, LATCHED_NEWEST, RELIABLE


class CountPublishers:
    """Publishes final counts latched, the last of each region, and running ones unlatched.

    Each region has publishers of its own, so that whoever comes late gets its last count and no
    other; how many regions there are only the reconstructor knows.
    """

    def __init__(self, node: ManagedNode):
        """Makes the publishers of a node that is being set up."""
        self._node = node
        self._running = node.advertise(StackCount, "running_count", RELIABLE)
        self._final = {"": self._advertise_final()}  # by region

    def _advertise_final(self) -> list[Publisher]:
        return [self._node.advertise(StackCount, topic, LATCHED_NEWEST) for topic in FINAL_TOPICS]

    def publish(self, count: StackCount) -> None:
        """Publishes a count, on the topics of those that are final or of those that are not."""
        if not count.final:
            self._running.publish(count)
            return
        if count.region not in self._final:
            self._final[count.region] = self._advertise_final()
        for publisher in self._final[count.region]:
            publisher.publish(count)
