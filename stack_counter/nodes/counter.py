# SPDX-License-Identifier: Apache-2.0
"""Counter node: `volume` in, `result` out; the action `count_stack` runs a whole scan."""

from __future__ import annotations

import traceback
from collections.abc import Mapping

from stack_counter_msgs.msg import StackCount, StackVolume
from visualization_msgs.msg import MarkerArray

from stack_counter.config import CounterConfig
from stack_counter.config.named_region import MOST_REGIONS
from stack_counter.errors import StackCounterError, defect_line
from stack_counter.nodes.count_action import CountAction
from stack_counter.nodes.count_publishers import CountPublishers
from stack_counter.nodes.result_logging import ResultLogging
from stack_counter.nodes.scale import Scale
from stack_counter.occupancy import make_estimator
from stack_counter.parts.part_lookup import configured_part, resolve_part
from stack_counter.ros.conversions import (
    failed_count,
    from_stack_volume,
    from_tally,
    to_stack_count,
)
from stack_counter.ros.count_fields import from_reasons, from_seconds
from stack_counter.ros.diagnostics import ERROR, OK, WARN, data_age_s
from stack_counter.ros.lifecycle import ManagedNode, run
from stack_counter.ros.markers import (
    ORIGIN_PLACE,
    TextPlace,
    count_marker,
    text_place,
    visible_marker,
)
from stack_counter.ros.part_fields import from_part_fields
from stack_counter.ros.qos import LATCHED_ALL, LATCHED_NEWEST
from stack_counter.ros.verdicts import set_verdict
from stack_counter.stack_count import count_stack
from stack_counter.views.decoding import stamp_ns
from stack_counter.visible_parts.finder import make_finder

_LEVELS = {StackCount.STATUS_OK: OK, StackCount.STATUS_DEGRADED: WARN,
           StackCount.STATUS_ERROR: ERROR}


class CounterNode(ManagedNode[CounterConfig]):
    """Adapter of `count_stack`: a volume comes in, a count goes out."""

    def __init__(self) -> None:
        """Declares the parameters."""
        super().__init__("counter", CounterConfig)

    def setup(self, config: CounterConfig) -> None:
        """Loads the estimator and connects it.

        Raises:
            StackCounterError: the estimator or the part cannot be loaded.
        """
        self._config = config
        self._check_part(config)
        self._estimator = make_estimator(config)
        self._finder = make_finder(config.visible_parts_weights,
                                   config.visible_part_poses)
        self._last: dict[str, StackCount] = {}  # of the last scan, by region
        self._counts = CountPublishers(self, config.result_json)
        self._marker = self.advertise(MarkerArray, "count_marker", LATCHED_NEWEST)
        # Of the last stack of each region: an error is written there as well.
        self._text_places: dict[str, TextPlace] = {}
        # Latched, so that a counter that starts late still counts the last volume.
        self.subscribe(StackVolume, "volume", self._on_volume, LATCHED_ALL)
        self._action = CountAction(self, config)
        self._scale = Scale(self, config)
        self._result_log = ResultLogging(config, self.get_logger())
        self.on_cleanup_call(self._action.destroy)
        self.on_cleanup_call(self._release_estimator)

    def _release_estimator(self) -> None:
        """Frees the memory of the networks."""
        del self._estimator, self._finder

    def apply_runtime_config(self, config: CounterConfig) -> None:
        """Has part, confidence and expected count hold from the next count on.

        Raises:
            StackCounterError: the part is unknown.
        """
        self._check_part(config)
        self._config = self._action.config = config

    @staticmethod
    def _check_part(config: CounterConfig) -> None:
        """Raises PartError or ConfigError if the settings name a part that is unknown."""
        if configured_part(config).names_a_part:
            resolve_part(configured_part(config), config.part_catalogue)

    def _on_volume(self, message: StackVolume) -> None:
        # Whoever reaches the domain may name regions, of which each takes publishers.
        if message.region not in self._text_places and len(self._text_places) >= MOST_REGIONS:
            self.get_logger().error(
                f"volume of region '{message.region}' dropped: it is one of more than "
                f"{MOST_REGIONS}; expected those of the reconstructor's settings",
                throttle_duration_sec=5.0)
            return
        # Count.
        count = self._count_volume(message)
        count.weights = self._weights
        count.age = data_age_s(self.get_clock().now().nanoseconds,
                               stamp_ns(message.header.stamp))
        if not count.error:
            set_verdict(count, self._config.expected_count, self._config.tolerance)
        # Publish the count, and show it above the stack.
        self._last = {region: last for region, last in self._last.items()
                      if last.scan_id == count.scan_id} | {count.region: count}
        self._counts.publish(count, message)
        self._log_count(count)
        self._action.on_count(count)
        self._publish_markers(text_place(message), count.region)
        self._result_log.write(count, message)

    def _publish_markers(self, place: TextPlace | None, region: str) -> None:
        """Shows the counts of all regions; `place`: of the region's stack; None if it has none."""
        self._text_places[region] = place or self._text_places.get(region, ORIGIN_PLACE)
        shown = [(self._last[name], place, number)
                 for number, (name, place) in enumerate(self._text_places.items())
                 if name in self._last]
        markers = [count_marker(*count) for count in shown]
        if self._finder is not None:
            markers += [visible_marker(count, number) for count, _, number in shown]
        self._marker.publish(MarkerArray(markers=markers))

    def _log_count(self, count: StackCount) -> None:
        """Logs an error, or the count of a scan that has ended with a sentence for each reason."""
        logger, line = self.get_logger(), f"scan '{count.scan_id}': {_region_prefix(count)}"
        if count.error and self._action.is_cancelled(count.scan_id):
            logger.info(f"{line}{count.error}; it was cancelled")
        elif count.error:
            logger.error(line + count.error)
        elif count.final and count.status == StackCount.STATUS_DEGRADED:
            logger.warning(line + _describe_count(count))
        elif count.final:
            logger.info(line + _describe_count(count))

    def _count_volume(self, message: StackVolume) -> StackCount:
        """Returns the count of a volume, or the error that there is instead."""
        request = from_part_fields(message)
        if not request.names_a_part:
            request = self._action.requested_part(message.scan_id)
            message.part, message.unit_volume = request.name, request.unit_volume
        try:
            # Read the catalogue again: it may have changed since the last count.
            known_part = resolve_part(request, self._config.part_catalogue)
            message.unit_volume = known_part.unit_volume
            if message.error:
                return failed_count(message.error, message)
            result = count_stack(from_stack_volume(message), known_part, self._estimator,
                                 self._action.requested_confidence(message.scan_id),
                                 self._scale.weighing(self._config), self._finder)
        except StackCounterError as error:
            return failed_count(message.error or str(error), message)
        except Exception as error:  # a volume that nobody expected must not go without an answer
            self.get_logger().error(traceback.format_exc())
            return failed_count(defect_line("counted", error), message)
        return to_stack_count(result, message)

    @property
    def _weights(self) -> str:
        return self._config.weights or "shipped"

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Returns the last counts with their reasons, and why the last goal was rejected."""
        lines = [(_LEVELS[last.status],
                  _region_prefix(last) + (last.error or _describe_count(last)))
                 for last in self._last.values()]
        lines += self._result_log.status_lines()
        if self._action.rejected:
            lines.append((WARN, f"the last goal was rejected: {self._action.rejected}"))
        return lines or [(OK, "no scan yet")]

    def status_values(self) -> Mapping[str, object]:
        """Returns the estimator, and the last counts with their views and times."""
        values: dict[str, object] = {"counting": self._action.is_busy,
                                     "estimator": self._estimator.name, "weights": self._weights}
        for last in self._last.values():
            prefix = _region_prefix(last)
            values |= {prefix + key: value for key, value in _count_values(last).items()}
        return values


def _region_prefix(count: StackCount) -> str:
    """Returns what a region's lines and values begin with; empty where none is named."""
    return f"{count.region}: " if count.region else ""


def _count_values(count: StackCount) -> dict[str, object]:
    """Returns a count with its views and times, by names for the diagnostics."""
    tally = from_tally(count.views)
    return {
        "scan_id": count.scan_id, "count": count.count, "count_low": count.count_low,
        "count_high": count.count_high, "age s": float(count.age),
        **{f"count by {s.source}": f"{s.count} ({s.share:.0%})" for s in count.count_sources},
        "reasons": ", ".join(count.reasons), "missing cameras": ", ".join(count.missing_cameras),
        "view_agreement mm": 1000 * count.view_agreement,
        "views received": tally.received, "views used": tally.used,
        **{f"seconds {stage}": s for stage, s in from_seconds(count.seconds).items()},
        **{f"skipped: {reason}": number for reason, number in tally.skipped.items()}}


def _describe_count(count: StackCount) -> str:
    """Returns the count in words: number, interval, status, and each reason's slug, sentence."""
    reasons = [f"{reason}: {reason.sentence}" for reason in from_reasons(count.reasons)]
    status = "degraded" if count.status == StackCount.STATUS_DEGRADED else "ok"
    return " ".join([f"{count.count} parts, {count.confidence:.0%} sure between "
                     f"{count.count_low} and {count.count_high}; {status}.", *reasons])


def main() -> None:
    """Runs the node."""
    run(CounterNode)


if __name__ == "__main__":
    main()
