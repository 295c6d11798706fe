# SPDX-License-Identifier: Apache-2.0
"""The node that hands the counter's results to stations: `stack-counter bridge`."""

from __future__ import annotations

import json
import re
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.context import Context
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.node import Node
from std_msgs.msg import String

from stack_counter.bridges.sinks import ResultSink, SinkThread
from stack_counter.config.named_region import MOST_REGIONS
from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.ros.qos import LATCHED_ALL, RESULT_JSON
from stack_counter.ros.security import check_security


@dataclass(frozen=True)
class BridgeSettings:
    """How the bridge listens; all are chosen.

    Attributes:
        watch_period_s: seconds between two looks for a counter, and whether the sinks run.
        remembered: results by which one that is counted again is known.
    """

    watch_period_s: float = 1.0
    remembered: int = 100


SETTINGS = BridgeSettings()


class Bridge:
    """Passes each result on once: a counter that starts again counts its last volume again.

    Attributes:
        node: subscribes to the results; whoever makes the bridge has it spin.
    """

    def __init__(self, sinks: SinkThread, context: Context | None = None):
        """Makes the node.

        Args:
            sinks: get the results.
            context: ROS context; None: the default one.
        """
        self._sinks = sinks
        self._passed: deque[dict[str, Any]] = deque(maxlen=SETTINGS.remembered)
        self._regions: set[str] = set()
        self._available: bool | None = None  # None: nothing was said so far
        self.node = Node("bridge", namespace=NAMESPACE, context=context)
        self.node.create_subscription(String, RESULT_JSON, self._on_result, LATCHED_ALL)
        self.node.create_timer(SETTINGS.watch_period_s, self._watch,
                               clock=Clock(clock_type=ClockType.STEADY_TIME))

    def _on_result(self, message: String) -> None:
        try:
            result = _read_result(message.data)
        except (ValueError, RecursionError) as error:
            self.node.get_logger().error(f"{RESULT_JSON}: {error}; expected a flat result")
            return
        self._regions.add(result["region"])
        if len(self._regions) > MOST_REGIONS:  # each takes topics and nodes of the stations
            self._regions.remove(result["region"])
            self.node.get_logger().error(
                f"{RESULT_JSON}: region '{result['region']}' is one of more than {MOST_REGIONS}; "
                "expected those of the reconstructor's settings", throttle_duration_sec=5.0)
            return
        # All but the seconds that it took.
        lasting = {key: value for key, value in result.items() if not key.startswith("seconds.")}
        if lasting not in self._passed:
            self._passed.append(lasting)
            self._sinks.put(result)

    def _watch(self) -> None:
        """Tells the sinks whether a counter is there. Raises ConfigError: a sink cannot run."""
        self._sinks.check()
        topic = self.node.resolve_topic_name(RESULT_JSON)
        # The supervisor publishes there as well, results of scans that were lost with a counter.
        available = any(publisher.node_name == "counter"
                        for publisher in self.node.get_publishers_info_by_topic(topic))
        if available != self._available:
            self._available = available
            self._sinks.set_available(available)
            self.node.get_logger().info(
                f"a counter publishes {topic}" if available else
                f"no counter publishes {topic}: it does with its parameter result_json:=true")


def _read_result(text: str) -> dict[str, Any]:
    """Returns a flat result. Raises ValueError: the text is none."""
    result = json.loads(text)
    region, stamp = (result.get(key) if isinstance(result, dict) else None
                     for key in ("region", "stamp"))
    # A region becomes a level of a topic, and a part of a node's name.
    if not (isinstance(region, str) and re.fullmatch(r"\w*", region) and isinstance(stamp, str)):
        raise ValueError(f"region is {region!r} and stamp {stamp!r}")
    datetime.fromisoformat(stamp.replace("Z", "+00:00"))  # raises what it says
    return result


def run_bridge(sinks: Sequence[ResultSink], ros_arguments: Sequence[str] = ()) -> int:
    """Passes results on until SIGINT or SIGTERM; returns the exit code.

    Args:
        sinks: get the results.
        ros_arguments: as -r FROM:=TO.

    Raises:
        ConfigError: a sink cannot run by its settings; security is asked for and cannot be had.
    """
    check_security()
    rclpy.init(args=["bridge", "--ros-args", *ros_arguments])
    thread = SinkThread(sinks)
    bridge = Bridge(thread)
    executor = SingleThreadedExecutor()
    executor.add_node(bridge.node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        bridge.node.destroy_node()
        thread.close()
        rclpy.try_shutdown()
    return 0
