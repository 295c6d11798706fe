# SPDX-License-Identifier: Apache-2.0
"""The scale under the container, as a topic."""

from __future__ import annotations

from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Float64

from stack_counter.config import CounterConfig
from stack_counter.ros.lifecycle import ManagedNode
from stack_counter.weighing.joined_count import Weighing, weighing_of
from stack_counter.weighing.scale_readings import ScaleReadings

# Hears every publisher; a reading that gets lost is followed by another.
_BEST_EFFORT = QoSProfile(depth=50, reliability=ReliabilityPolicy.BEST_EFFORT)


class Scale:
    """Says what the scale shows when a volume comes."""

    def __init__(self, node: ManagedNode, config: CounterConfig):
        """Subscribes to the topic, if the settings name one, for a node that is being set up."""
        self._clock = node.steady  # the messages have no stamps
        self._readings = ScaleReadings(config.weight_std_kg, config.weight_max_age_s)
        if config.weight_topic:
            node.subscribe(Float64, config.weight_topic, self._on_weight, _BEST_EFFORT)

    def _on_weight(self, message: Float64) -> None:
        now = self._clock.now().nanoseconds
        self._readings.add(now, message.data)
        self._readings.forget_before(now)

    def weighing(self, config: CounterConfig) -> Weighing | None:
        """Returns what the scale shows now; None where the settings name none.

        Args:
            config: settings as they are now.
        """
        return weighing_of(config, self._readings.stable_weight(self._clock.now().nanoseconds))
