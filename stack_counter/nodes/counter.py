"""Counter node: `volume` in, `count` out; the action `count_stack` runs a whole scan."""

from __future__ import annotations

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.qos import DurabilityPolicy, QoSProfile
from stack_counter_msgs.msg import StackCount, StackVolume
from std_msgs.msg import Header

from stack_counter.config import CounterConfig
from stack_counter.errors import StackCounterError
from stack_counter.nodes.base import LATCHED, ManagedNode, run
from stack_counter.nodes.conversions import failed_count, to_stack_count
from stack_counter.nodes.count_action import CountAction
from stack_counter.occupancy import make_estimator
from stack_counter.parts import resolve_unit_volume
from stack_counter.pipeline import count_stack
from stack_counter.stack_messages import from_stack_volume

_LEVELS = {StackCount.STATUS_OK: DiagnosticStatus.OK,
           StackCount.STATUS_DEGRADED: DiagnosticStatus.WARN,
           StackCount.STATUS_ERROR: DiagnosticStatus.ERROR}


class CounterNode(ManagedNode[CounterConfig]):
    """Drives `count_stack`."""

    def __init__(self) -> None:
        super().__init__("counter", CounterConfig)

    def setup(self, config: CounterConfig) -> None:
        """Loads the estimator and connects it."""
        self._config = config
        self._estimator = make_estimator(config)
        self._last: StackCount | None = None
        self._count = self.advertise(StackCount, "count", LATCHED)
        self._diagnostics = self.advertise(DiagnosticArray, "/diagnostics", QoSProfile(depth=1))
        # Latched, so that a counter that starts late still counts the last volume; deep, so
        # that no volume of the continuous mode is lost.
        self.subscribe(StackVolume, "volume", self._on_volume,
                       QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL))
        self._action = CountAction(self, self._config.confidence)
        self.undo_with(self._action.destroy)
        self.tick(1.0, self._diagnose)

    def _on_volume(self, message: StackVolume) -> None:
        self._last = self._counted(message)
        self._last.weights = self._config.weights or "shipped"
        self._count.publish(self._last)
        if self._last.error:
            self.get_logger().error(f"scan '{message.scan_id}': {self._last.error}")
        self._action.on_count(self._last)

    def _counted(self, message: StackVolume) -> StackCount:
        if message.error:
            return failed_count(message.error, message)
        part, unit_volume = message.part, message.unit_volume
        if not part and not unit_volume:
            part, unit_volume = self._config.part, self._config.unit_volume_m3
        try:
            unit_volume = resolve_unit_volume(part, unit_volume)
            result = count_stack(from_stack_volume(message), unit_volume, self._estimator,
                                 self._action.confidence)
        except StackCounterError as error:
            return failed_count(str(error), message)
        return to_stack_count(result, message)

    def _diagnose(self) -> None:
        last = self._last
        status = DiagnosticStatus(name="stack_counter: count", hardware_id="",
                                  level=DiagnosticStatus.OK, message="no scan yet")
        if last is not None:
            status.level = _LEVELS[last.status]
            reasons = ", ".join(last.reasons) or "ok"
            status.message = last.error or f"{last.count} parts ({reasons})"
            skipped = dict(zip(last.views.skip_reasons, last.views.skip_counts))
            status.values = [KeyValue(key=key, value=str(value)) for key, value in (
                ("scan_id", last.scan_id), ("estimator", last.estimator),
                ("views received", last.views.received), ("views used", last.views.used),
                *((f"skipped: {reason}", number) for reason, number in skipped.items()))]
        header = Header(stamp=self.get_clock().now().to_msg())
        self._diagnostics.publish(DiagnosticArray(header=header, status=[status]))


def main() -> None:
    """Runs the node."""
    run(CounterNode)


if __name__ == "__main__":
    main()
