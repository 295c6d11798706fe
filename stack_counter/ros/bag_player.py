# SPDX-License-Identifier: Apache-2.0
"""Plays a recording into whatever nodes run: `stack-counter play`.

Messages go out at the pace of the recording, with their stamps as recorded. Played in a loop, each
repetition has its stamps later than the one before: nodes that skip what they have seen, and TF,
which goes forward alone, take each as new.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rclpy
from rclpy.duration import Duration
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.serialization import deserialize_message

from stack_counter.bag.formats.recording_file import Record
from stack_counter.bag.reader import BagReader
from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.errors import BagError
from stack_counter.ros.processes import shared_memory_environment
from stack_counter.ros.qos import LATCHED_ALL, record_qos
from stack_counter.ros.security import check_security
from stack_counter.ros.standard_messages import message_type, to_time
from stack_counter.views.decoding import stamp_ns


@dataclass(frozen=True)
class BagPlayerSettings:
    """Times of the player; all are chosen.

    Attributes:
        match_s: longest wait, before the first message, for subscribers of every topic, s: to find
            each other takes nodes some tenths of a second.
        poll_s: seconds between two looks at the subscribers.
        deliver_s: longest wait, after the last message, until all have been received, s.
        loop_gap_ns: time from the last stamp of a repetition to the first of the next, ns; more
            than the widest gap that TF is interpolated in.
    """

    match_s: float = 3.0
    poll_s: float = 0.05
    deliver_s: float = 3.0
    loop_gap_ns: int = 10**9


SETTINGS = BagPlayerSettings()


class StampShift:
    """Makes the stamps of a recording's repetitions go on where the one before has ended.

    Stamps of 0 mean no time and stay; those of /tf_static, which may be much older than the
    recording, do not say how long it is.
    """

    def __init__(self) -> None:
        """Makes one for the first repetition, whose stamps are as recorded."""
        self.shift_ns = 0
        self._first_ns, self._last_ns = 0, 0  # recorded so far; 0 before the first

    def apply(self, topic: str, message: Any) -> None:
        """Moves the stamps of a message's header, or of its transforms, and notes them."""
        headers = [message.header] if hasattr(message, "header") else \
            [transform.header for transform in getattr(message, "transforms", ())]
        for header in headers:
            recorded_ns = stamp_ns(header.stamp)
            if not recorded_ns:
                continue
            header.stamp = to_time(recorded_ns + self.shift_ns)
            if topic != "/tf_static":
                self._first_ns = min(recorded_ns, self._first_ns or recorded_ns)
                self._last_ns = max(recorded_ns, self._last_ns)

    def repeat(self) -> None:
        """Goes on to the next repetition."""
        self.shift_ns += self._last_ns - self._first_ns + SETTINGS.loop_gap_ns


def play_bag(path: Path, rate: float, loop: bool, say: Callable[[str], object],
             on_message: Callable[[], None]) -> None:
    """Publishes a bag's messages on the ROS domain of the environment.

    Args:
        path: rosbag2 folder, or a file of a recording.
        rate: speed of the recording's clock, above 0.
        loop: begin again at its end, until a signal comes.
        say: takes lines for people.
        on_message: called for each message played.

    Raises:
        FileNotFoundError: there is no such path.
        BagError: the bag cannot be read, or none of its topics can be played.
        ConfigError: security is asked for and cannot be had.
    """
    check_security()
    reader = BagReader(path)
    types, refused = playable_topics(reader.topics)
    for topic, why in refused.items():
        say(f"not played: {topic}: {why}")
    if not types:
        raise BagError(f"{path} has no topic that can be played; expected messages of installed "
                       f"types; it has {', '.join(reader.topics) or 'no topics'}")
    os.environ.update(shared_memory_environment())  # read by the DDS library at the start
    with _publishing_node() as node:
        publishers = _advertise(node, types, reader.latched)
        _wait_for_subscribers(publishers)
        for line in _describe(path, reader, publishers):
            say(line)
        _play(reader, publishers, rate, loop, say, on_message)
        _wait_until_received(publishers.values())


def playable_topics(topics: Mapping[str, tuple[str, int]]
                    ) -> tuple[dict[str, type], dict[str, str]]:
    """Returns the classes of the topics that can be played, and why the others are not.

    Args:
        topics: type name and number of messages by topic.
    """
    types, refused = {}, {}
    for topic, (kind, _) in topics.items():
        if topic.startswith(f"{NAMESPACE}/"):
            refused[topic] = "it is what our own nodes publish; expected what they take"
            continue
        try:
            types[topic] = message_type(kind)
        except (ImportError, AttributeError, ValueError):
            refused[topic] = f"its type {kind} is not installed"
    return types, refused


@contextmanager
def _publishing_node() -> Iterator[Node]:
    """Makes a node in a context of its own, which leaves signals to the command."""
    context = rclpy.context.Context()
    rclpy.init(args=[], context=context)  # the command's own words are not for ROS
    node = rclpy.create_node("bag_player", namespace=NAMESPACE, context=context)
    try:
        yield node
    finally:
        node.destroy_node()
        rclpy.try_shutdown(context=context)


def _advertise(node: Node, types: Mapping[str, type], latched: set[str]) -> dict[str, Publisher]:
    """Makes reliable publishers, which every subscriber matches; latched as when recorded."""
    return {topic: node.create_publisher(kind, topic, _qos(topic, kind, topic in latched))
            for topic, kind in types.items()}


def _qos(topic: str, kind: type, latched: bool) -> QoSProfile:
    return LATCHED_ALL if latched else record_qos(topic, kind.__name__)


def _wait_for_subscribers(publishers: Mapping[str, Publisher]) -> None:
    """Waits until somebody subscribes to each topic, for some seconds at most."""
    deadline = time.monotonic() + SETTINGS.match_s
    while time.monotonic() < deadline \
            and not all(p.get_subscription_count() for p in publishers.values()):
        time.sleep(SETTINGS.poll_s)


def _describe(path: Path, reader: BagReader, publishers: Mapping[str, Publisher]) -> list[str]:
    """Says which topics are played, and to which nobody subscribes."""
    numbers = {topic: reader.topics[topic][1] for topic in publishers}
    lines = [f"playing {path}: {sum(numbers.values())} messages on {len(numbers)} topics"
             + ("; the bag is cut short" if reader.truncated else "")]
    lines += [f"  {number:6d}  {topic}  {reader.topics[topic][0]}"
              for topic, number in numbers.items()]
    silent = [topic for topic, p in publishers.items() if not p.get_subscription_count()]
    if len(silent) == len(publishers):
        lines.append("nobody subscribes to any of them on ROS domain "
                     f"{os.environ.get('ROS_DOMAIN_ID', '0')}; expected running nodes")
    elif silent:
        lines.append(f"nobody subscribes to {', '.join(silent)}")
    return lines


def _play(reader: BagReader, publishers: Mapping[str, Publisher], rate: float, loop: bool,
          say: Callable[[str], object], on_message: Callable[[], None]) -> None:
    """Publishes all messages at their time; in a loop, again and again."""
    shift = StampShift()
    while True:
        first_ns, begin = None, time.monotonic()
        for record in reader.records(set(publishers)):
            first_ns = record.log_time_ns if first_ns is None else first_ns
            due = begin + (record.log_time_ns - first_ns) * 1e-9 / rate
            time.sleep(max(due - time.monotonic(), 0.0))
            publisher = publishers[record.topic]
            publisher.publish(_shifted(record, publisher, shift) if loop else record.data)
            on_message()
        if not loop:
            return
        shift.repeat()
        say(f"from the beginning; stamps are later by {shift.shift_ns * 1e-9:.1f} s")
        time.sleep(SETTINGS.loop_gap_ns * 1e-9 / rate)


def _shifted(record: Record, publisher: Publisher, shift: StampShift) -> Any:
    """Returns a record's message with the stamps of this repetition."""
    message = deserialize_message(record.data, publisher.msg_type)
    shift.apply(record.topic, message)
    return message


def _wait_until_received(publishers: Iterable[Publisher]) -> None:
    """Waits until the last messages have been received, for some seconds at most."""
    deadline = time.monotonic() + SETTINGS.deliver_s
    for publisher in publishers:
        publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))
