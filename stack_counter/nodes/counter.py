"""Counter node: `volume` in, `count` out; the action `count_stack` runs a whole scan."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from stack_counter_msgs.msg import StackCount, StackVolume
from visualization_msgs.msg import MarkerArray

from stack_counter.config import CounterConfig
from stack_counter.errors import StackCounterError
from stack_counter.nodes.count_action import CountAction
from stack_counter.occupancy.baselines import make_estimator
from stack_counter.parts.catalogue import Part, resolve_part
from stack_counter.pipeline import count_stack
from stack_counter.ros.conversions import (
    failed_count,
    from_stack_volume,
    set_verdict,
    to_stack_count,
)
from stack_counter.ros.diagnostics import ERROR, OK, WARN
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.markers import count_markers, text_place
from stack_counter.ros.qos import LATCHED, LATCHED_ALL, LATCHED_NEWEST
from stack_counter.views.decoding import stamp_ns

_LEVELS = {StackCount.STATUS_OK: OK, StackCount.STATUS_DEGRADED: WARN,
           StackCount.STATUS_ERROR: ERROR}


class CounterNode(ManagedNode[CounterConfig]):
    """Drives `count_stack`."""

    def __init__(self) -> None:
        super().__init__("counter", CounterConfig)

    def setup(self, config: CounterConfig) -> None:
        """Loads the estimator and connects it."""
        self._config = config
        if config.part or config.unit_volume_m3:
            self._known(config, config.part, config.unit_volume_m3)  # or say why not
        self._estimator = make_estimator(config)
        self._last: StackCount | None = None
        self._count = self.advertise(StackCount, "count", LATCHED)
        self._text = self.advertise(MarkerArray, "count_marker", LATCHED_NEWEST)
        self._text_place = (np.zeros(3), 0.03)  # of the last stack: an error is written there too
        # Latched, so that a counter that starts late still counts the last volume; deep, so
        # that no volume of the continuous mode is lost.
        self.subscribe(StackVolume, "volume", self._on_volume,
                       LATCHED_ALL)
        self._action = CountAction(self, config)
        self.on_cleanup_call(self._action.destroy)
        self.on_cleanup_call(self._free)

    def _free(self) -> None:
        """Gives back the memory of the network."""
        del self._estimator

    def apply_runtime_config(self, config: CounterConfig) -> None:
        """Part, confidence and what is expected hold from the next count on."""
        if config.part or config.unit_volume_m3:
            self._known(config, config.part, config.unit_volume_m3)
        self._config = self._action.config = config

    @staticmethod
    def _known(config: CounterConfig, part: str, unit_volume: float) -> Part:
        """What is known of a part now: its catalogue may have changed since the last count."""
        return resolve_part(part, unit_volume, config.part_catalogue)

    def _on_volume(self, message: StackVolume) -> None:
        count = self._counted(message)
        count.weights = self._config.weights or "shipped"
        count.age = (self.get_clock().now().nanoseconds - stamp_ns(message.header.stamp)) * 1e-9
        if not count.error:
            set_verdict(count, self._config.expected_count, self._config.tolerance)
        self._last = count
        self._count.publish(count)
        if count.error:
            self.get_logger().error(f"scan '{message.scan_id}': {count.error}")
        self._action.on_count(count)
        self._text_place = text_place(message) or self._text_place
        self._text.publish(count_markers(count, *self._text_place))

    def _counted(self, message: StackVolume) -> StackCount:
        if message.error:
            return failed_count(message.error, message)
        part, unit_volume = message.part, message.unit_volume
        if not part and not unit_volume:
            part, unit_volume = self._config.part, self._config.unit_volume_m3
        try:
            known = self._known(self._config, part, unit_volume)
            result = count_stack(from_stack_volume(message), known, self._estimator,
                                 self._action.confidence_of(message.scan_id))
        except StackCounterError as error:
            return failed_count(str(error), message)
        return to_stack_count(result, message)

    def status_lines(self) -> list[tuple[bytes, str]]:
        """What the last count is worth, and why the last goal was refused."""
        found = []
        last = self._last
        if last is not None:
            reasons = ", ".join(last.reasons) or "ok"
            found.append((_LEVELS[last.status], last.error or f"{last.count} parts ({reasons})"))
        if self._action.rejected:
            found.append((WARN, f"the last goal was rejected: {self._action.rejected}"))
        return found or [(OK, "no scan yet")]

    def status_values(self) -> Mapping[str, object]:
        """The last count in numbers, who said it, and how long it took."""
        values: dict[str, object] = {"counting": self._action.busy,
                                     "estimator": self._estimator.name,
                                     "weights": self._config.weights or "shipped"}
        last = self._last
        if last is not None:
            skipped = dict(zip(last.views.skip_reasons, last.views.skip_counts))
            values |= {
                "scan_id": last.scan_id, "count": last.count, "count_low": last.count_low,
                "count_high": last.count_high, "age s": float(last.age),
                "missing cameras": ", ".join(last.missing_cameras),
                "views received": last.views.received, "views used": last.views.used,
                **{f"seconds {stage}": float(s) for stage, s in
                   zip(last.seconds.stages, last.seconds.seconds)},
                **{f"skipped: {reason}": number for reason, number in skipped.items()}}
        return values


def main() -> None:
    """Runs the node."""
    run(CounterNode)


if __name__ == "__main__":
    main()
