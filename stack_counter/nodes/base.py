"""What the three lifecycle nodes share: parameters from a settings class, self-start, main."""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Callable
from typing import Any, Generic

import rclpy
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.subscription import Subscription

from stack_counter.config import NAMESPACE, Section, build
from stack_counter.errors import StackCounterError

# Reliable everywhere: best effort loses images even on one machine. Latched topics give their
# last messages to whoever subscribes later; deep enough that a running result of the continuous
# mode is not overwritten before it is delivered.
RELIABLE = QoSProfile(depth=100, history=HistoryPolicy.KEEP_LAST,
                      reliability=ReliabilityPolicy.RELIABLE)
LATCHED = QoSProfile(depth=20, history=HistoryPolicy.KEEP_LAST,
                     reliability=ReliabilityPolicy.RELIABLE,
                     durability=DurabilityPolicy.TRANSIENT_LOCAL)


class ManagedNode(LifecycleNode, Generic[Section]):
    """A lifecycle node whose parameters are the fields of one settings class."""

    def __init__(self, name: str, section: type[Section]):
        super().__init__(name, namespace=NAMESPACE)
        self._section = section
        self._undo: list[Callable[[], Any]] = []  # gives back what `setup` makes
        self.active = False
        for setting in dataclasses.fields(section):
            default = list(setting.default) if isinstance(setting.default, tuple) \
                else setting.default
            self.declare_parameter(setting.name, default, _descriptor(setting))
        self.autostart = self.declare_parameter(
            "autostart", True,
            ParameterDescriptor(description="configure and activate at start")).value

    def read_config(self) -> Section:
        """The parameters as a checked settings object.

        Raises:
            ConfigError: a value is out of range.
        """
        names = [f.name for f in dataclasses.fields(self._section)]
        values = {p.name: p.value for p in self.get_parameters(names)}
        return build(self._section, values)

    def setup(self, config: Section) -> None:
        """Makes what the node needs; called on configure."""
        raise NotImplementedError

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reads the parameters and sets the node up; a bad one fails the transition."""
        try:
            self.setup(self.read_config())
        except StackCounterError as error:
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """From now on data is taken."""
        self.active = True
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Data is no longer taken; what was taken stays."""
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Gives back all that configure made."""
        while self._undo:
            self._undo.pop()()
        return TransitionCallbackReturn.SUCCESS

    def undo_with(self, undo: Callable[[], Any]) -> None:
        """Has cleanup call this."""
        self._undo.append(undo)

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile) -> Subscription:
        """A subscription whose messages count only while the node is active."""
        def guarded(message: Any) -> None:
            if not self.active:
                return
            try:
                callback(message)
            except Exception:  # one bad message must not take the node down
                self.get_logger().error(f"message on {topic} dropped:\n{traceback.format_exc()}")

        made = self.create_subscription(kind, topic, guarded, qos)
        self._undo.append(lambda: self.destroy_subscription(made))
        return made

    def advertise(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        """A publisher that cleanup destroys."""
        made = self.create_publisher(kind, topic, qos)
        self._undo.append(lambda: self.destroy_publisher(made))
        return made

    def serve(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """A service that cleanup destroys."""
        made = self.create_service(kind, name, callback)
        self._undo.append(lambda: self.destroy_service(made))

    def tick(self, period_s: float, callback: Callable[[], None]) -> None:
        """A timer that runs while the node is active."""
        made = self.create_timer(period_s, lambda: callback() if self.active else None)
        self._undo.append(lambda: self.destroy_timer(made))


def _descriptor(setting: dataclasses.Field) -> ParameterDescriptor:
    meta = setting.metadata
    text = meta["doc"] + (f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else "")
    descriptor = ParameterDescriptor(description=text)
    if meta["low"] is not None and meta["high"] is not None:
        if isinstance(setting.default, float):
            descriptor.floating_point_range = [FloatingPointRange(
                from_value=float(meta["low"]), to_value=float(meta["high"]))]
        elif isinstance(setting.default, int):
            descriptor.integer_range = [IntegerRange(from_value=int(meta["low"]),
                                                     to_value=int(meta["high"]), step=1)]
    return descriptor


def run(make_node: Any) -> None:
    """Main of a node: starts it, brings it up unless `autostart` is false, spins until told."""
    rclpy.init()
    node = make_node()
    executor = SingleThreadedExecutor()  # nothing here blocks: the action waits on futures
    executor.add_node(node)
    try:
        if node.autostart and node.trigger_configure() == TransitionCallbackReturn.SUCCESS:
            node.trigger_activate()
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
