"""What the three lifecycle nodes share: parameters from a settings class, states, diagnostics."""

from __future__ import annotations

import dataclasses
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Generic

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from stack_counter.config import NAMESPACE, Section, build
from stack_counter.errors import StackCounterError
from stack_counter.ros.diagnostics import ERROR, OK, memory_mb, to_array, worst
from stack_counter.ros.qos import DIAGNOSTICS

_DIAGNOSE_S = 1.0


class ManagedNode(LifecycleNode, Generic[Section]):
    """A lifecycle node whose parameters are the fields of one settings class."""

    def __init__(self, name: str, section: type[Section]):
        super().__init__(name, namespace=NAMESPACE)
        self._section = section
        self._cleanup_calls: list[Callable[[], Any]] = []  # gives back what `setup` makes
        self._qos_mismatches: dict[str, str] = {}  # topic -> with whom its QoS does not fit
        self.active = self._configured = False
        # Waiting and being late are matters of wall time, also where the clock is a bag's.
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        for setting in dataclasses.fields(section):
            default = list(setting.default) if isinstance(setting.default, tuple) \
                else setting.default
            self.declare_parameter(setting.name, default, _descriptor(setting))
        self.autostart = self.declare_parameter(
            "autostart", True,
            ParameterDescriptor(description="configure and activate at start")).value
        self.add_on_set_parameters_callback(self._on_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics",
                                                  DIAGNOSTICS)
        self.create_timer(_DIAGNOSE_S, self._diagnose, clock=self.steady)

    def read_config(self) -> Section:
        """The parameters as a checked settings object.

        Raises:
            ConfigError: a value is out of range.
        """
        return build(self._section, self._values())

    def setup(self, config: Section) -> None:
        """Makes what the node needs; called on configure."""
        raise NotImplementedError

    def apply_runtime_config(self, config: Section) -> None:
        """Takes over settings that may change while the node is configured.

        Raises:
            StackCounterError: it cannot; then the old ones hold.
        """

    def status_lines(self) -> list[tuple[bytes, str]]:
        """What an operator should know: levels and lines; called once a second while active."""
        return []

    def status_values(self) -> Mapping[str, object]:
        """Figures for the diagnostics, while configured."""
        return {}

    # --- lifecycle ----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reads the parameters and sets the node up; a bad one fails the transition."""
        try:
            self.setup(self.read_config())
        except StackCounterError as error:
            self.get_logger().error(str(error))
            self._release()
            return TransitionCallbackReturn.FAILURE
        self._configured = True
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
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """The same, from any state."""
        self.active = False
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """After a fault of ours in a transition: unconfigured, from where one can go on."""
        self.active = False
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def _release(self) -> None:
        while self._cleanup_calls:
            self._cleanup_calls.pop()()
        self._qos_mismatches.clear()
        self._configured = False

    # --- parameters ---------------------------------------------------------------------------

    def _values(self) -> dict[str, Any]:
        names = [f.name for f in dataclasses.fields(self._section)]
        return {p.name: p.value for p in self.get_parameters(names)}

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuses what is out of range, and what cannot change while the node is configured."""
        fields = {f.name: f for f in dataclasses.fields(self._section)}
        ours = {p.name: p.value for p in parameters if p.name in fields}
        fixed = [name for name in ours if not fields[name].metadata["runtime"]]
        if self._configured and fixed:
            return SetParametersResult(successful=False, reason=(
                f"{', '.join(fixed)} is read on configure; expected an unconfigured node: clean "
                "it up first"))
        try:
            config = build(self._section, {**self._values(), **ours})
            if self._configured and ours:
                self.apply_runtime_config(config)
        except StackCounterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        return SetParametersResult(successful=True)

    # --- diagnostics --------------------------------------------------------------------------

    def _diagnose(self) -> None:
        found = [(ERROR, f"{topic}: {why}") for topic, why in self._qos_mismatches.items()]
        if self.active:
            found += self.status_lines()
        level, message = worst(*found)
        state = "active" if self.active else "inactive" if self._configured else "unconfigured"
        values = {"state": state, "memory MB": memory_mb(),
                  **(self.status_values() if self._configured else {})}
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(to_array(self.get_name(), level,
                                           message if level != OK or self.active else state,
                                           values, header))

    # --- connections --------------------------------------------------------------------------

    def on_cleanup_call(self, undo: Callable[[], Any]) -> None:
        """Has cleanup call this."""
        self._cleanup_calls.append(undo)

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile) -> Subscription:
        """A subscription whose messages count only while the node is active."""
        def guarded(message: Any) -> None:
            if not self.active:
                return
            try:
                callback(message)
            except Exception:  # one bad message must not take the node down
                if not self.context.ok():  # a signal has ended it: nothing can be published
                    return
                self.get_logger().error(f"message on {topic} dropped:\n{traceback.format_exc()}",
                                        throttle_duration_sec=5.0)

        def unfit(event: Any) -> None:
            why = (f"{event.total_count} publishers offer another QoS (policy "
                   f"{event.last_policy_kind}); expected what this node asks for: "
                   "see parameter reliable")
            self._qos_mismatches[topic] = why
            self.get_logger().error(f"{topic}: {why}")

        made = self.create_subscription(
            kind, topic, guarded, qos,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=unfit))
        self._cleanup_calls.append(lambda: self.destroy_subscription(made))
        return made

    def advertise(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        """A publisher that cleanup destroys."""
        made = self.create_publisher(kind, topic, qos)
        self._cleanup_calls.append(lambda: self.destroy_publisher(made))
        return made

    def add_service(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """A service that cleanup destroys."""
        made = self.create_service(kind, name, callback)
        self._cleanup_calls.append(lambda: self.destroy_service(made))

    def add_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """A timer that runs while the node is active."""
        made = self.create_timer(period_s, lambda: callback() if self.active else None,
                                 clock=self.steady)
        self._cleanup_calls.append(lambda: self.destroy_timer(made))


def _descriptor(setting: dataclasses.Field) -> ParameterDescriptor:
    meta = setting.metadata
    text = meta["doc"] + (f" (one of: {', '.join(meta['choices'])})" if meta["choices"] else "")
    descriptor = ParameterDescriptor(
        description=text, additional_constraints="may change at run time" if meta["runtime"]
        else "read on configure; set it while the node is unconfigured")
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
    except RuntimeError:  # a signal has ended the context under a callback that publishes
        if rclpy.ok():
            raise
    finally:
        executor.shutdown()
        node.destroy_node()
        rclpy.try_shutdown()
