# SPDX-License-Identifier: Apache-2.0
"""What the three lifecycle nodes share: parameters from a settings class, states, diagnostics."""

from __future__ import annotations

import dataclasses
import sys
import traceback
from collections.abc import Callable, Mapping
from typing import Any, Generic

import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import ParameterDescriptor, SetParametersResult
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from rclpy.subscription import Subscription
from std_msgs.msg import Empty, Header

from stack_counter.config import SETTING_NAMES, Section, build_section
from stack_counter.config.named_region import REGIONS, nest
from stack_counter.config.parameter_files import NAMESPACE, misspelled_names
from stack_counter.config.setting_fields import path_refusal
from stack_counter.errors import StackCounterError, naming_missing_packages
from stack_counter.ros.bad_requests import guarded
from stack_counter.ros.descriptors import describe_parameter
from stack_counter.ros.diagnostics import ERROR, OK, memory_mb, process_age_s, summarize, to_array
from stack_counter.ros.node_arguments import fully_named
from stack_counter.ros.qos import DIAGNOSTICS, HEARTBEAT
from stack_counter.ros.security import exit_if_insecure
from stack_counter.tasks.child_processes import end_with_parent

_DIAGNOSTICS_PERIOD_S = 1.0


class ManagedNode(LifecycleNode, Generic[Section]):
    """A lifecycle node whose parameters are the fields of one settings class."""

    def __init__(self, name: str, section: type[Section]):
        """Declares a parameter for every field of `section`; the node is not configured yet."""
        # Named regions have parameters whose names only the settings file knows.
        super().__init__(name, namespace=NAMESPACE,
                         automatically_declare_parameters_from_overrides=True)
        self._section: type[Section] = section
        self._cleanup_calls: list[Callable[[], Any]] = []
        self._qos_mismatches: dict[str, str] = {}  # an explanation for each topic
        self.active = self._configured = False
        self._service_group = MutuallyExclusiveCallbackGroup()
        # Waiting and being late are matters of wall time, also where the clock is a bag's.
        self.steady = Clock(clock_type=ClockType.STEADY_TIME)
        for field in dataclasses.fields(section):
            if field.name != REGIONS:
                default = list(field.default) if isinstance(field.default, tuple) \
                    else field.default
                self._declare(field.name, default, describe_parameter(field))
        self.autostart = self._declare(
            "autostart", True, ParameterDescriptor(description="configure and activate at start"))
        for given, meant in misspelled_names(self.get_parameters_by_prefix(""), SETTING_NAMES,
                                             name).items():
            self.get_logger().error(f"unknown parameter '{given}'; expected '{meant}'")
        self.add_on_set_parameters_callback(self._on_parameters)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", DIAGNOSTICS)
        self._heartbeat = self.create_publisher(Empty, "~/heartbeat", HEARTBEAT)
        self.create_timer(_DIAGNOSTICS_PERIOD_S, self._publish_diagnostics, clock=self.steady)

    def _declare(self, name: str, default: Any, descriptor: ParameterDescriptor) -> Any:
        """Declares a parameter; returns its value, by the settings file or else the default."""
        if self.has_parameter(name):  # by the settings file, and not described
            self.undeclare_parameter(name)
        return self.declare_parameter(name, default, descriptor).value

    def read_config(self) -> Section:
        """Returns the parameters as a checked settings object.

        Raises:
            ConfigError: a value is out of range.
        """
        return build_section(self._section, nest(self._parameter_values()))

    def setup(self, config: Section) -> None:
        """Makes what the node needs; called on configure.

        Raises:
            StackCounterError: a setting cannot be followed; the node stays unconfigured.
        """
        raise NotImplementedError

    def apply_runtime_config(self, config: Section) -> None:
        """Takes over settings that may change while the node is configured.

        Raises:
            StackCounterError: a setting cannot be followed; the old ones stay in force.
        """

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Returns levels and lines for the operator; called once a second while active."""
        return []

    def status_values(self) -> Mapping[str, object]:
        """Returns values for the diagnostics by name; called while configured."""
        return {}

    # --- lifecycle ----------------------------------------------------------------------------

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Reads the parameters and sets the node up; a bad one fails the transition."""
        try:
            with naming_missing_packages():
                self.setup(self.read_config())
        except StackCounterError as error:
            self.get_logger().error(str(error))
            self._release()
            return TransitionCallbackReturn.FAILURE
        self._configured = True
        return TransitionCallbackReturn.SUCCESS

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Lets callbacks process messages from now on."""
        self.active = True
        self.get_logger().info(f"ready {process_age_s():.1f} s after the start of its process")
        return super().on_activate(state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Stops callbacks from processing messages; the scan so far is kept."""
        self.active = False
        return super().on_deactivate(state)

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Releases all that `setup` made."""
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Releases all that `setup` made, from any state."""
        self.active = False
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        """Brings the node back to unconfigured after an exception in a transition."""
        self.active = False
        self._release()
        return TransitionCallbackReturn.SUCCESS

    def _release(self) -> None:
        """Undoes `setup`, the last step first."""
        while self._cleanup_calls:
            self._cleanup_calls.pop()()
        self._qos_mismatches.clear()
        self._configured = False

    # --- parameters ---------------------------------------------------------------------------

    def _parameter_values(self) -> dict[str, Any]:
        """Returns the value of every parameter of the node's settings by its name."""
        names = [name for name in self.get_parameters_by_prefix("") if self._is_setting(name)]
        return {parameter.name: parameter.value for parameter in self.get_parameters(names)}

    def _is_setting(self, parameter: str) -> bool:
        """Whether the node's settings hold a parameter, e.g. `live` or `regions.left.size_m`."""
        return parameter.split(".")[0] in {f.name for f in dataclasses.fields(self._section)}

    def _on_parameters(self, parameters: list[Parameter]) -> SetParametersResult:
        """Refuses what is out of range, and what cannot change while the node is configured."""
        fields = {field.name: field for field in dataclasses.fields(self._section)}
        changes = {p.name: p.value for p in parameters if self._is_setting(p.name)}
        before = self._parameter_values()
        # Refuse paths: they are said by whoever starts the node, not over the network.
        for name in [name for name, value in changes.items() if value != before.get(name)]:
            if refused := path_refusal(fields[name.split(".")[0]], changes[name]):
                return SetParametersResult(successful=False, reason=refused)
        # Refuse what is read on configure alone.
        fixed = [name for name in changes if not fields[name.split(".")[0]].metadata["runtime"]]
        if self._configured and fixed:
            return SetParametersResult(successful=False, reason=(
                f"{', '.join(fixed)} is read on configure; expected an unconfigured node: clean "
                "it up first"))
        # Check all settings together, then take them over.
        try:
            config = build_section(self._section, nest({**before, **changes}))
            if self._configured and changes:
                self.apply_runtime_config(config)
        except StackCounterError as error:
            return SetParametersResult(successful=False, reason=str(error))
        except Exception as error:  # one bad request must not take the node down
            self.get_logger().error(f"parameters refused:\n{traceback.format_exc()}")
            return SetParametersResult(successful=False, reason=f"{type(error).__name__}: {error}")
        for name in changes.keys() & before.keys():
            if changes[name] != before[name]:
                self.get_logger().info(f"parameter {name} changed from {before[name]!r} to "
                                       f"{changes[name]!r}")
        return SetParametersResult(successful=True)

    # --- diagnostics --------------------------------------------------------------------------

    def _publish_diagnostics(self) -> None:
        self._heartbeat.publish(Empty())
        lines = [(ERROR, f"{topic}: {why}") for topic, why in self._qos_mismatches.items()]
        if self.active:
            lines += self.status_lines()
        level, message = summarize(lines)
        state = "active" if self.active else "inactive" if self._configured else "unconfigured"
        values = {"state": state, "memory MB": memory_mb(),
                  **(self.status_values() if self._configured else {})}
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(to_array(self.get_name(), level,
                                           message if level != OK or self.active else state,
                                           values, header))

    # --- connections --------------------------------------------------------------------------

    def on_cleanup_call(self, release: Callable[[], Any]) -> None:
        """Registers a function that cleanup calls, the last one registered first."""
        self._cleanup_calls.append(release)

    def subscribe(self, kind: type, topic: str, callback: Callable[[Any], None],
                  qos: QoSProfile) -> Subscription:
        """Makes a subscription whose messages are processed only while the node is active.

        Args:
            kind: class of the messages.
            topic: name; relative ones are below the node's namespace.
            callback: called with each message; an exception of it is logged.
            qos: what is asked of publishers; those that offer less are an error in the
                diagnostics.
        """
        def process(message: Any) -> None:
            if not self.active:
                return
            try:
                callback(message)
            except Exception:  # one bad message must not take the node down
                if not self.context.ok():  # a signal has ended it: nothing can be published
                    return
                self.get_logger().error(f"message on {topic} dropped:\n{traceback.format_exc()}",
                                        throttle_duration_sec=5.0)

        def report_mismatch(event: Any) -> None:
            why = (f"{event.total_count} publishers offer another QoS (policy "
                   f"{event.last_policy_kind}); expected what this node asks for: "
                   "see parameter reliable")
            self._qos_mismatches[topic] = why
            self.get_logger().error(f"{topic}: {why}")

        made = self.create_subscription(
            kind, topic, process, qos,
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=report_mismatch))
        self._cleanup_calls.append(lambda: self.destroy_subscription(made))
        return made

    def advertise(self, kind: type, topic: str, qos: QoSProfile) -> Publisher:
        """Makes a publisher that cleanup destroys."""
        made = self.create_publisher(kind, topic, qos)
        self._cleanup_calls.append(lambda: self.destroy_publisher(made))
        return made

    def add_service(self, kind: type, name: str, callback: Callable[[Any, Any], Any]) -> None:
        """Makes a service that cleanup destroys; while it awaits something, the node goes on."""
        made = self.create_service(kind, name, guarded(kind, callback, self.get_logger()),
                                   callback_group=self._service_group)
        self._cleanup_calls.append(lambda: self.destroy_service(made))

    def add_timer(self, period_s: float, callback: Callable[[], None]) -> None:
        """Makes a timer that calls while the node is active, in wall time; cleanup destroys it."""
        made = self.create_timer(period_s, lambda: callback() if self.active else None,
                                 clock=self.steady)
        self._cleanup_calls.append(lambda: self.destroy_timer(made))


def run(node_class: type[ManagedNode]) -> None:
    """Runs a node until SIGINT or SIGTERM; configures and activates it if `autostart` is true."""
    end_with_parent()
    exit_if_insecure()
    with fully_named(sys.argv) as arguments:
        rclpy.init(args=arguments)
    node = node_class()  # type: ignore[call-arg]  # nodes name themselves
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
