# SPDX-License-Identifier: Apache-2.0
"""A node that plays a bag's records into the three nodes and follows their scan."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile
from stack_counter_msgs.msg import ScanStatus, StackCount, StackVolume
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter.bag.reader import BagReader
from stack_counter.bag.replayed import no_count_line
from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.errors import ScanError
from stack_counter.ros.conversions import from_skips
from stack_counter.ros.heard_counts import HeardCounts
from stack_counter.ros.part_fields import to_part_fields
from stack_counter.ros.processes import NodeError, NodeProcesses
from stack_counter.ros.qos import LATCHED_ALL, RELIABLE, record_qos
from stack_counter.ros.standard_messages import message_type
from stack_counter.types import PartRequest, ViewTally


@dataclass(frozen=True)
class PlayerSettings:
    """How far the player runs ahead of the nodes, and how long it waits for them.

    All are chosen; what is waited for normally takes a small part of the time. They end a replay
    whose nodes hang, not one on a busy machine.

    Attributes:
        max_images_ahead: number of images played and not yet processed; by the design of the
            ROS interface.
        start_timeout_s: seconds for the nodes to start and answer; weights are loaded meanwhile.
        answer_timeout_s: seconds after which an answer to a start is taken as lost: a server drops
            it where it has not yet discovered the client, and the request is made again.
        stall_timeout_s: seconds without an image processed after which a node hangs.
        count_timeout_s: seconds from the last image to the count: SAM 2 takes seconds for each
            view without a GPU.
        arrival_timeout_s: seconds that the last images may take to reach the collector.
        settle_s: seconds that the last images wait for depth or TF that may still come.
        poll_s: longest time between two checks that the nodes are alive, s.
    """

    max_images_ahead: int = 4
    start_timeout_s: float = 300.0
    answer_timeout_s: float = 10.0
    stall_timeout_s: float = 180.0
    count_timeout_s: float = 900.0
    arrival_timeout_s: float = 30.0
    settle_s: float = 3.0
    poll_s: float = 0.2


SETTINGS = PlayerSettings()
# The end of a cycle must not be missed, whoever is found first.
EVERY_STATUS = QoSProfile(depth=500, durability=DurabilityPolicy.TRANSIENT_LOCAL)


class Player(Node):
    """Publishes a bag's records, at most some images ahead of the nodes.

    Attributes:
        heard: what the nodes have measured and counted.
    """

    def __init__(self, nodes: NodeProcesses, color_topics: set[str], topics: dict[str, str],
                 cycle_ns: int, regions: Iterable[str], context: rclpy.context.Context):
        """Makes publishers, subscriptions and clients.

        Args:
            nodes: checked to be alive whenever the player waits.
            color_topics: topics of colour images.
            topics: type names by topic, of those that the collector subscribes to.
            cycle_ns: 0, or how long a cycle's images take, ns, of a rig whose scans start by
                themselves.
            regions: names of those that are counted; one empty name where none is named.
            context: of the private domain.
        """
        super().__init__("player", namespace=NAMESPACE, context=context)
        self._nodes = nodes
        self._changed = threading.Condition()
        self._collector = self._reconstructor = ScanStatus()
        self._color_topics = color_topics
        self._images_sent = self._images_of_open_scan = 0
        self._cycle_ns, self._cycle_begin_ns = cycle_ns, -2 * cycle_ns
        self._cycle_sizes: dict[str, int] = {}  # number of images of each cycle that is closed
        self._cycles_finished: set[str] = set()  # by the reconstructor
        self.heard = HeardCounts(regions)
        self._record_publishers: dict[str, Publisher] = {
            topic: self.create_publisher(message_type(kind), topic, record_qos(topic, kind))
            for topic, kind in topics.items()}
        self.create_subscription(ScanStatus, "scan_status", self._on_status, EVERY_STATUS)
        self.create_subscription(StackVolume, "volume", self._on_volume, LATCHED_ALL)
        self.create_subscription(StackCount, "result", self._on_count, LATCHED_ALL)
        self.create_subscription(StackCount, "running_count", self._on_count, RELIABLE)
        self._start = self.create_client(StartScan, "start_scan")
        self._stop = self.create_client(StopScan, "stop_scan")
        self._reset = self.create_client(Trigger, "reset")

    # --- what the nodes publish ---------------------------------------------------------------

    def _on_status(self, message: ScanStatus) -> None:
        with self._changed:
            if message.state == ScanStatus.STOPPED and message.node == "collector":
                self._cycle_sizes[message.scan_id] = message.received
            elif message.state == ScanStatus.STOPPED:
                self._cycles_finished.add(message.scan_id)
            if message.node == "collector":
                self._collector = message
                if message.state == ScanStatus.SCANNING:
                    self._images_of_open_scan = message.received
            elif message.scan_id == self._collector.scan_id:
                self._reconstructor = message
            self._changed.notify_all()

    def _on_volume(self, message: StackVolume) -> None:
        with self._changed:
            self.heard.add_volume(message)
            self._changed.notify_all()

    def _on_count(self, message: StackCount) -> None:
        with self._changed:
            self.heard.add_count(message)
            self._changed.notify_all()

    def wait_until(self, condition: Callable[[], bool], seconds: float) -> bool:
        """Waits for a condition on what the nodes have published; returns whether it holds.

        Raises:
            NodeError: a node has ended.
        """
        deadline = time.monotonic() + seconds
        with self._changed:
            while not condition():
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                self._nodes.check()
                self._changed.wait(min(left, SETTINGS.poll_s))
        return True

    def _sleep(self, seconds: float) -> None:
        """Waits, unless a node ends."""
        self.wait_until(lambda: False, seconds)

    def wait_for_nodes(self) -> None:
        """Waits until all three nodes are up and receive what is played.

        Raises:
            NodeError: they are not in time, or a node has ended.
        """
        if not self.wait_until(self._is_connected, SETTINGS.start_timeout_s):
            raise NodeError(f"nodes not connected within {SETTINGS.start_timeout_s} s; the nodes "
                            f"said: {self._nodes.last_lines()}")

    def _is_connected(self) -> bool:
        return (self._start.service_is_ready() and self._stop.service_is_ready()
                and self._reset.service_is_ready()
                and all(p.get_subscription_count() for p in self._record_publishers.values())
                and bool(self.count_publishers("volume")) and bool(self.count_publishers("result"))
                and bool(self.count_subscribers("posed_images"))
                and self.count_subscribers("volume") >= 2)

    # --- the scan -----------------------------------------------------------------------------

    def start_scan(self, part: PartRequest) -> None:
        """Starts a scan of a part; the collector receives every topic of it.

        Raises:
            NodeError: the scan is refused, or the collector does not receive a topic.
        """
        request = StartScan.Request(**to_part_fields(part))
        deadline = time.monotonic() + SETTINGS.start_timeout_s
        problem = ""
        while time.monotonic() < deadline:
            answer = self._answer(self._start, request, SETTINGS.answer_timeout_s)
            if answer is None:
                problem = "start_scan gave no answer; expected one"
            elif answer.accepted:
                unmatched = set(answer.unmatched_topics) & set(self._record_publishers)
                if not unmatched:
                    return
                problem = f"the collector does not receive {sorted(unmatched)}; expected a match"
            elif not problem:
                raise NodeError(f"start_scan refused: {answer.message}")
            # Begin a scan anew whose answer was lost, or that would lack what is played.
            self._answer(self._reset, Trigger.Request(), SETTINGS.answer_timeout_s)
            self._sleep(0.1)
        raise NodeError(f"{problem} within {SETTINGS.start_timeout_s} s")

    def play(self, reader: BagReader, rate: float, on_view: Callable[[], None]) -> None:
        """Publishes all records of the topics.

        Args:
            reader: of the bag.
            rate: 0 to play as fast as the nodes process images, or the speed of the recording's
                clock, which does not wait for slow nodes.
            on_view: called for each image played.

        Raises:
            NodeError: a node has ended or hangs.
        """
        first_ns, begin = None, time.monotonic()
        for record in reader.records(set(self._record_publishers), self._color_topics):
            # Wait for the record's time.
            first_ns = record.log_time_ns if first_ns is None else first_ns
            if rate:
                due = begin + (record.log_time_ns - first_ns) * 1e-9 / rate
                self._sleep(due - time.monotonic())
            # Wait for the nodes to process images played before.
            if record.topic in self._color_topics:
                if not rate:
                    self._wait_for_room(self._max_images_ahead(record.log_time_ns))
                self._images_sent += 1
                on_view()
            self._record_publishers[record.topic].publish(record.data)
        # What has not arrived when the scan ends would be no part of it.
        self.wait_until(lambda: self._images_received() >= self._images_sent,
                        SETTINGS.arrival_timeout_s)
        self.wait_until(lambda: self._images_ahead() <= 0, SETTINGS.settle_s)

    def stop_scan(self) -> str:
        """Ends the scan, or the last cycle, and waits for its counts; returns its id.

        Raises:
            ScanError: there is none, since no image has come.
            NodeError: there is no count in time, or a node has ended.
        """
        stopped = self._answer(self._stop, StopScan.Request(), SETTINGS.start_timeout_s)
        if stopped is None:
            raise NodeError(f"stop_scan gave no answer within {SETTINGS.start_timeout_s} s")
        if not stopped.accepted:
            status = self._collector
            tally = ViewTally(status.received, skipped=from_skips(status))
            raise ScanError(no_count_line(stopped.message, tally, []))
        if not self.wait_until(lambda: self.heard.has_ended(stopped.scan_id),
                               SETTINGS.count_timeout_s):
            raise NodeError(f"no count of scan '{stopped.scan_id}' within "
                            f"{SETTINGS.count_timeout_s} s")
        # Running counts come on another topic, and may come later than the final one.
        self.wait_until(lambda: self.heard.is_settled, SETTINGS.settle_s)
        return stopped.scan_id

    def _answer(self, client: Any, request: Any, seconds: float) -> Any:
        """Returns a service's answer; None where it does not come in time."""
        future = client.call_async(request)
        return future.result() if self.wait_until(future.done, seconds) else None

    def _images_received(self) -> int:
        """Returns the number of images that have reached the collector."""
        return sum(self._cycle_sizes.values()) + self._images_of_open_scan

    def _images_ahead(self) -> int:
        """Returns the number of images played that no node has finished or skipped."""
        if self._cycle_ns:
            # Images of a cycle without any view are skipped; it is never closed.
            status = self._collector
            skipped = sum(status.skip_counts) if status.state == ScanStatus.SCANNING else 0
            finished = sum(size for scan_id, size in self._cycle_sizes.items()
                           if scan_id in self._cycles_finished)
            return self._images_sent - finished - skipped
        return self._images_sent - sum(self._collector.skip_counts) - self._reconstructor.received

    def _wait_for_room(self, max_ahead: int) -> None:
        if not self.wait_until(lambda: self._images_ahead() < max_ahead,
                               SETTINGS.stall_timeout_s):
            raise NodeError(f"{self._images_ahead()} images not yet processed and no progress "
                            f"within {SETTINGS.stall_timeout_s} s; expected less than {max_ahead}")

    def _max_images_ahead(self, log_time_ns: int) -> int:
        """Returns how many images may be on their way beside one of this time.

        Of a rig's, these are those of its own cycle: while the nodes wait for an image of a
        camera that is dead, the next cycle would wait too.
        """
        if not self._cycle_ns:
            return SETTINGS.max_images_ahead
        if log_time_ns - self._cycle_begin_ns > self._cycle_ns:
            self._cycle_begin_ns = log_time_ns
            return 1
        return len(self._color_topics)
