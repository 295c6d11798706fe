"""Plays a bag through the three real nodes and waits for their count: `replay --nodes`."""

from __future__ import annotations

import importlib
import os
import threading
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import rclpy
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from stack_counter_msgs.msg import ScanStatus, StackCount, StackVolume
from stack_counter_msgs.srv import StartScan, StopScan
from std_srvs.srv import Trigger

from stack_counter.bag.reader import BagReader, fit_rig, listened
from stack_counter.bag.replay import Replayed, count_entry, no_count
from stack_counter.config import NAMESPACE, Config
from stack_counter.counting import flagged
from stack_counter.ros.conversions import from_stack_count, from_stack_volume, from_tally
from stack_counter.ros.processes import NodeError, NodeProcesses, private_environment
from stack_counter.ros.qos import LATCHED_ALL
from stack_counter.views.rig import RigAssembler, load_rig

_AHEAD = 4  # images played that have not yet been processed
_START_WITHIN_S = 60.0
_STALL_S = 30.0  # no image processed for so long: a node hangs
_PATIENT_S = 20.0  # how long the collector waits for a pose that the bag may still hold
_COUNT_WITHIN_S = 900.0  # of the last image: SAM 2 takes seconds a view without a GPU
_SETTLE_S = 3.0  # last images wait so long for depth or TF that may still come


class Player(Node):
    """Publishes a bag's records and follows the scan."""

    def __init__(self, colors: set[str], topics: dict[str, str], cycle_ns: int,
                 context: rclpy.context.Context):
        """Makes publishers.

        Args:
            colors: topics of colour images.
            topics: type names by topic, those the collector listens to.
            cycle_ns: 0, or how long a cycle's images take, of a rig whose scans start by
                themselves.
            context: of the private domain.
        """
        super().__init__("player", namespace=NAMESPACE, context=context)
        self._changed = threading.Condition()
        self._collector = self._reconstructor = ScanStatus()
        self._sent = 0  # colour images played
        self._cycle_ns, self._cycle_began_ns = cycle_ns, -2 * cycle_ns
        self._of_cycle: dict[str, int] = {}  # images of each that is closed
        self._done = 0  # images of cycles that the reconstructor has finished
        self.volume = StackVolume()  # the last one
        self.counts: list[StackCount] = []
        self._colors = colors
        self._publishers_of: dict[str, Publisher] = {
            topic: self.create_publisher(
                message_type(kind), topic,
                LATCHED_ALL if topic == "/tf_static" else QoSProfile(depth=1000 if topic == "/tf"
                                                                    else 50))
            for topic, kind in topics.items()}
        self.create_subscription(ScanStatus, "scan_status", self._on_status, QoSProfile(depth=500))
        self.create_subscription(StackVolume, "volume", self._on_volume, LATCHED_ALL)
        self.create_subscription(StackCount, "count", self._on_count, LATCHED_ALL)
        self._start = self.create_client(StartScan, "start_scan")
        self._stop = self.create_client(StopScan, "stop_scan")
        self._reset = self.create_client(Trigger, "reset")

    # --- what the nodes say -------------------------------------------------------------------

    def _on_status(self, message: ScanStatus) -> None:
        with self._changed:
            if message.state == ScanStatus.STOPPED and message.node == "collector":
                self._of_cycle[message.scan_id] = message.received
            elif message.state == ScanStatus.STOPPED:
                self._done += self._of_cycle.get(message.scan_id, 0)
            if message.node == "collector":
                self._collector = message
            elif message.scan_id == self._collector.scan_id:
                self._reconstructor = message
            self._changed.notify_all()

    def _on_volume(self, message: StackVolume) -> None:
        with self._changed:
            self.volume = message

    def _on_count(self, message: StackCount) -> None:
        with self._changed:
            self.counts.append(message)
            self._changed.notify_all()

    def wait(self, condition: Callable[[], bool], seconds: float, check: Callable[[], None]
             ) -> bool:
        """Waits for a condition on what the nodes have said; `check` raises if a node died."""
        deadline = time.monotonic() + seconds
        with self._changed:
            while not condition():
                left = deadline - time.monotonic()
                if left <= 0:
                    return False
                check()
                self._changed.wait(min(left, 0.2))
        return True

    def connected(self) -> bool:
        """Whether all three nodes are up and hear what is played."""
        return (self._start.service_is_ready() and self._stop.service_is_ready()
                and self._reset.service_is_ready()
                and all(p.get_subscription_count() for p in self._publishers_of.values())
                and bool(self.count_publishers("volume")) and bool(self.count_publishers("count"))
                and bool(self.count_subscribers("posed_images"))
                and self.count_subscribers("volume") >= 2)

    def ahead(self) -> int:
        """Images played that no node is done with: neither used nor skipped."""
        if self._cycle_ns:
            return self._sent - self._done
        return self._sent - sum(self._collector.skip_counts) - self._reconstructor.received

    # --- the scan -----------------------------------------------------------------------------

    def call(self, client: Any, request: Any, check: Callable[[], None]) -> Any:
        """A service's answer."""
        future = client.call_async(request)
        if not self.wait(future.done, _START_WITHIN_S, check):
            raise NodeError(f"service {client.srv_name} gave no answer within {_START_WITHIN_S} s")
        return future.result()

    def start_scan(self, part: str, unit_volume: float, check: Callable[[], None]) -> str:
        """Opens a scan; returns its id."""
        request = StartScan.Request(part=part, unit_volume=unit_volume)
        deadline = time.monotonic() + _START_WITHIN_S
        while time.monotonic() < deadline:
            answer = self.call(self._start, request, check)
            if not answer.accepted:
                raise NodeError(f"start_scan refused: {answer.message}")
            unheard = set(answer.unmatched_topics) & set(self._publishers_of)
            if not unheard:
                return answer.scan_id
            self.call(self._reset, Trigger.Request(), check)
            self.wait(lambda: False, 0.1, check)
        raise NodeError(f"the collector does not hear {sorted(unheard)}; expected a match within "
                        f"{_START_WITHIN_S} s")

    def play(self, reader: BagReader, rate: float, on_view: Callable[[], None],
             check: Callable[[], None]) -> None:
        """Publishes all records, at most a few images ahead of the nodes."""
        first_ns, begin = None, time.monotonic()
        for record in reader.records(set(self._publishers_of)):
            first_ns = record.log_time_ns if first_ns is None else first_ns
            if rate:  # real time does not wait for slow nodes
                due = begin + (record.log_time_ns - first_ns) * 1e-9 / rate
                self.wait(lambda: False, due - time.monotonic(), check)
            if record.topic in self._colors:
                if not rate:
                    self._wait_for_room(self._may_be_ahead(record.log_time_ns), check)
                self._sent += 1
                on_view()
            self._publishers_of[record.topic].publish(record.data)
        self.wait(lambda: self.ahead() <= 0, _SETTLE_S, check)

    def _wait_for_room(self, most: int, check: Callable[[], None]) -> None:
        if not self.wait(lambda: self.ahead() < most, _STALL_S, check):
            raise NodeError(f"{self.ahead()} images not yet processed and no progress within "
                            f"{_STALL_S} s; expected less than {most}")

    def _may_be_ahead(self, log_time_ns: int) -> int:
        """Images that may be on their way beside one of this time. Of a rig's, those of its own
        cycle: while a camera is waited for that is dead, the next cycle would be waiting too."""
        if not self._cycle_ns:
            return _AHEAD
        if log_time_ns - self._cycle_began_ns > self._cycle_ns:
            self._cycle_began_ns = log_time_ns
            return 1
        return len(self._colors)

    def stop_scan(self, scan_id: str, check: Callable[[], None]) -> StackCount:
        """Ends the scan, or the last cycle; returns its final count."""
        stopped = self.call(self._stop, StopScan.Request(), check)
        scan_id = stopped.scan_id or scan_id

        def final() -> bool:
            last = self.counts[-1] if self.counts else StackCount()
            return last.final and last.scan_id == scan_id == self.volume.scan_id

        if not self.wait(final, _COUNT_WITHIN_S, check):
            raise NodeError(f"no count of scan '{scan_id}' within {_COUNT_WITHIN_S} s")
        return self.counts[-1]


def message_type(name: str) -> type:
    """The class of a type named as in a bag, e.g. `sensor_msgs/msg/Image`."""
    package, _, kind = name.split("/")
    return getattr(importlib.import_module(f"{package}.msg"), kind)


def replay_nodes(path: Path, config: Config, part: str, unit_volume: float, rate: float,
                 on_view: Callable[[], None], begin: float) -> Replayed:
    """Plays a bag through collector, reconstructor and counter over DDS.

    Args:
        path: rosbag2 folder or .mcap file.
        config: settings; topics are fitted to the bag.
        part, unit_volume: what is in the bin; m3, 0 for the part's.
        rate: 0 to play as fast as the nodes take it, or the speed of the recording's clock.
        on_view: called for each image played.
        begin: when the command began (`time.perf_counter`): imports count as loading.

    Raises:
        BagError: the bag has no usable topics.
        NodeError: a node died or hangs.
        ScanError: the nodes say why there is no count.
    """
    environment = private_environment()
    os.environ.update(environment)  # read by the DDS library when the context starts
    context = rclpy.context.Context()
    reader = BagReader(path)
    rig = fit_rig(load_rig(config.collector), reader.topics)
    cycles = config.collector.mode == "cycle"
    collector = config.collector if config.collector.rig else rig.cameras[0].config
    # All that the bag has will come, however slowly: only what it lacks is not worth a long wait.
    posed = {"/tf", "/tf_static", collector.pose_topic} & set(reader.topics)
    if posed and all(c.config.camera_info_topic in reader.topics for c in rig.cameras):
        collector = replace(collector, tf_timeout_s=_PATIENT_S)
    assembler = RigAssembler(rig)
    wanted = {name: reader.topics[name][0] for name in listened(assembler)
              if name in reader.topics}
    rclpy.init(context=context, domain_id=int(environment["ROS_DOMAIN_ID"]))
    player = Player(set(assembler.color_topics()), wanted,
                    round(rig.tolerance_s * 1e9) if cycles else 0, context)
    executor = SingleThreadedExecutor(context=context)
    executor.add_node(player)
    spinner = threading.Thread(target=_spin, args=(executor,), daemon=True)
    spinner.start()
    try:
        with NodeProcesses(replace(config, collector=collector), environment) as nodes:
            if not player.wait(player.connected, _START_WITHIN_S, nodes.check):
                raise NodeError(f"nodes not connected within {_START_WITHIN_S} s; they said: "
                                f"{nodes.last_words()}")
            loaded = time.perf_counter()
            scan_id = player.start_scan(part, unit_volume, nodes.check)
            player.play(reader, rate, on_view, nodes.check)
            played = time.perf_counter()
            message = player.stop_scan(scan_id, nodes.check)
    finally:
        executor.shutdown()
        player.destroy_node()
        rclpy.try_shutdown(context=context)
        spinner.join()
    if message.error:
        raise no_count(message.error, from_tally(message.views), [])
    count = from_stack_count(message, from_stack_volume(player.volume))
    if reader.truncated:
        count = flagged(count, "bag_truncated")
    seconds = {"load": loaded - begin, "read": played - loaded,
               "total": time.perf_counter() - begin}
    errors = tuple(m.error for m in player.counts if m.error)
    by_stamp = {c.volume.stamp_ns: count_entry(c) for c in
                (from_stack_count(m, from_stack_volume(StackVolume(
                    header=m.header, missing_cameras=m.missing_cameras)))
                 for m in player.counts if not m.error)}
    return Replayed(replace(count, seconds={**count.seconds, **seconds}),
                    list(by_stamp.values()) if config.reconstructor.live or cycles else [],
                    errors)


def _spin(executor: SingleThreadedExecutor) -> None:
    try:
        executor.spin()
    except ExternalShutdownException:
        pass
