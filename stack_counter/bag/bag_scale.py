# SPDX-License-Identifier: Apache-2.0
"""The scale under the container, as a bag has recorded it."""

from __future__ import annotations

import math
from collections.abc import Set
from dataclasses import replace

from stack_counter.bag.formats.recording_file import decoding
from stack_counter.bag.reader import BagReader
from stack_counter.bag.time_range import WHOLE_BAG
from stack_counter.config import Config, CounterConfig
from stack_counter.errors import BagError
from stack_counter.weighing.joined_count import Weighing, weighing_of
from stack_counter.weighing.scale_readings import ScaleReadings

_FLOAT = "std_msgs/msg/Float64"


class BagScale:
    """Readings of the topic that the settings name; none where the bag has no such topic."""

    def __init__(self, reader: BagReader, config: CounterConfig):
        """Reads all of them, also before the part of the bag that is counted.

        Raises:
            BagError: the topic has other messages, or one does not decode.
        """
        self._config = config
        self._readings = ScaleReadings(config.weight_std_kg, config.weight_max_age_s)
        topic = config.weight_topic
        kind = reader.topics.get(topic, (_FLOAT, 0))[0]
        if kind != _FLOAT:
            raise BagError(f"weight_topic {topic} has messages {kind}; expected {_FLOAT}, kg")
        for record in reader.part(WHOLE_BAG).records({topic}) if topic in reader.topics else ():
            with decoding(record):
                self._readings.add(record.log_time_ns, float(record.decode().data))

    def weighing_at(self, time_ns: int) -> Weighing | None:
        """Returns what the scale says at a time, ns since 1970; None without a scale."""
        return weighing_of(self._config, self._readings.stable_weight(time_ns))

    def stable_weight(self, time_ns: int) -> float | None:
        """Returns the newest stable weight at a time, with the container's, kg; None without."""
        return self._readings.stable_weight(time_ns)


def with_weight_of_bag(config: Config, reader: BagReader, color_topics: Set[str]) -> Config:
    """Settings that have the weight as a number, where the bag has it when its scan ends.

    Args:
        config: settings; a weight that they give as a number holds.
        reader: of the bag.
        color_topics: topics of colour images, of which the last one ends the scan.

    Raises:
        BagError: the topic has other messages, or one does not decode.
    """
    if math.isfinite(config.counter.weight_kg) or not config.counter.weight_topic:
        return config
    weight = BagScale(reader, config.counter).stable_weight(reader.last_time_ns(color_topics))
    if weight is None:
        return config
    return replace(config, counter=replace(config.counter, weight_topic="", weight_kg=weight))
