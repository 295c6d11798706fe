# SPDX-License-Identifier: Apache-2.0
"""In which state the three nodes are: all that a health check asks."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

import rclpy
from lifecycle_msgs.srv import GetState
from rclpy.context import Context
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node

from stack_counter.config.parameter_files import NAMESPACE
from stack_counter.ros.graph_findings import NO_ANSWER, NOT_RUNNING
from stack_counter.ros.processes import NODES, shared_memory_environment
from stack_counter.ros.security import check_security


@dataclass(frozen=True)
class NodeStateSettings:
    """How long nodes are waited for; both are chosen.

    Attributes:
        discovery_s: longest wait until all three are found, seconds.
        answer_s: longest wait for a node's state, seconds.
    """

    discovery_s: float = 4.0
    answer_s: float = 2.0


SETTINGS = NodeStateSettings()


class GraphWatcher:
    """A node that asks the three nodes for their states.

    Attributes:
        node: the node.
    """

    def __init__(self, name: str, context: Context | None = None):
        """Makes the node. `context`: the ROS context; None: the default one."""
        self.node = Node(name, namespace=NAMESPACE, context=context)
        self._executor = SingleThreadedExecutor(context=context)
        self._executor.add_node(self.node)

    def close(self) -> None:
        """Ends the node."""
        self._executor.shutdown()
        self.node.destroy_node()

    def spin(self, seconds: float, is_done: Callable[[], bool] = lambda: False) -> None:
        """Takes what comes for some seconds, or until something is done."""
        end = time.monotonic() + seconds
        while not is_done() and (left := end - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=min(left, 0.1))

    def find_states(self) -> dict[str, str]:
        """Waits until the three nodes are found, and returns the state of each by its name."""
        self.spin(SETTINGS.discovery_s, lambda: all(map(self._is_found, NODES)))
        return {name: self.state_of(name) for name in NODES}

    def state_of(self, name: str) -> str:
        """Name of the state of a node's lifecycle, or why there is none."""
        if not self._is_found(name):
            return NOT_RUNNING
        client = self.node.create_client(GetState, _service(name))
        self.spin(SETTINGS.answer_s, client.service_is_ready)
        future = client.call_async(GetState.Request())
        self.spin(SETTINGS.answer_s, future.done)
        answer = future.result() if future.done() else None
        self.node.destroy_client(client)
        return str(answer.current_state.label) if answer is not None else NO_ANSWER

    def _is_found(self, name: str) -> bool:
        return _service(name) in dict(self.node.get_service_names_and_types())


def _service(name: str) -> str:
    return f"{NAMESPACE}/{name}/get_state"


@contextmanager
def ros_of_a_command() -> Iterator[None]:
    """Has ROS run while a command looks at the live graph, with the nodes' profile of the DDS.

    Raises:
        ConfigError: security is asked for and cannot be had.
    """
    check_security()
    os.environ.update(shared_memory_environment())
    rclpy.init(args=[])  # the command's own words are not for ROS
    try:
        yield
    finally:
        rclpy.try_shutdown()


def examine_nodes() -> dict[str, str]:
    """State of each of the three nodes on the live graph by its name, or why there is none.

    Raises:
        ConfigError: security is asked for and cannot be had.
    """
    with ros_of_a_command():
        watcher = GraphWatcher("health")
        try:
            return watcher.find_states()
        finally:
            watcher.close()
