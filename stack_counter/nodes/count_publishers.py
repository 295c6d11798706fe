# SPDX-License-Identifier: Apache-2.0
"""The topics of counts: `result`, as JSON too, `running_count`, `visible_parts`, and `count`."""

from __future__ import annotations

from dataclasses import dataclass

from rclpy.publisher import Publisher
from stack_counter_msgs.msg import StackCount, StackVolume, VisibleParts
from std_msgs.msg import String

from stack_counter.ros.count_fields import to_visible_parts
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.ros.qos import FINAL_TOPICS, LATCHED_NEWEST, RELIABLE, RESULT_JSON
from stack_counter.ros.result_line import to_flat_json


@dataclass(frozen=True)
class _FinalPublishers:
    """Publishers of the final counts of one region.

    Attributes:
        counts: of the topics that carry the count's message.
        json: of the topic that carries it as JSON; None where that is not wanted.
    """

    counts: list[Publisher]
    json: Publisher | None


class CountPublishers:
    """Publishes final counts latched, the last of each region, and running ones unlatched.

    Each region has publishers of its own, so that whoever comes late gets its last count and no
    other; how many regions there are only the reconstructor knows.
    """

    def __init__(self, node: ManagedNode, with_json: bool):
        """Makes the publishers of a node that is being set up.

        Args:
            node: publishes.
            with_json: whether final counts go out as JSON as well.
        """
        self._node, self._with_json = node, with_json
        self._visible = node.advertise(VisibleParts, "visible_parts", LATCHED_NEWEST)
        self._running = node.advertise(StackCount, "running_count", RELIABLE)
        self._final = {"": self._advertise_final()}  # by region

    def _advertise_final(self) -> _FinalPublishers:
        return _FinalPublishers(
            [self._node.advertise(StackCount, topic, LATCHED_NEWEST) for topic in FINAL_TOPICS],
            self._node.advertise(String, RESULT_JSON, LATCHED_NEWEST) if self._with_json else None)

    def publish(self, count: StackCount, volume: StackVolume) -> None:
        """Publishes a count, on the topics of those that are final or of those that are not.

        Args:
            count: what is published.
            volume: what it was counted from.
        """
        if not count.error:
            self._visible.publish(to_visible_parts(count))
        if not count.final:
            self._running.publish(count)
            return
        if count.region not in self._final:
            self._final[count.region] = self._advertise_final()
        final = self._final[count.region]
        for publisher in final.counts:
            publisher.publish(count)
        if final.json is not None:
            final.json.publish(to_flat_json(count, volume))
