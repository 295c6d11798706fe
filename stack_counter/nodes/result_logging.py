# SPDX-License-Identifier: Apache-2.0
"""The final counts of the counter, as lines of `result_log`."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from rclpy.impl.rcutils_logger import RcutilsLogger
from stack_counter_msgs.msg import StackCount, StackVolume

from stack_counter.config import CounterConfig
from stack_counter.display.report import as_dict
from stack_counter.display.result_log import ResultLog
from stack_counter.display.result_schema import SCHEMA_VERSION
from stack_counter.ros.conversions import (
    from_stack_count,
    from_stack_volume,
    from_tally,
)
from stack_counter.ros.diagnostics import WARN
from stack_counter.views.decoding import stamp_ns

_WARNING_PERIOD_S = 60.0  # between two warnings
_VERDICTS = {StackCount.VERDICT_NONE: "none", StackCount.VERDICT_PASS: "pass",
             StackCount.VERDICT_FAIL: "fail", StackCount.VERDICT_UNSURE: "unsure"}


class ResultLogging:
    """Writes final counts to the log; where that fails, it says so and counts go on."""

    def __init__(self, config: CounterConfig, logger: RcutilsLogger):
        """Writes nothing yet, and never where `result_log` is empty."""
        self._logger = logger
        self._lost, self._error = 0, ""
        self._log = ResultLog(Path(config.result_log), config.result_log_max_mb) \
            if config.result_log else None

    def write(self, count: StackCount, volume: StackVolume) -> None:
        """Appends a line for a final count, or for the reason that there is none.

        Args:
            count: as published.
            volume: what it was counted from.
        """
        if self._log is None or not count.final:
            return
        try:
            self._log.append(result_line(count, volume))
            self._error = ""
        except OSError as error:
            self._lost += 1
            self._error = f"result_log: {error}; {self._lost} results are not in it"
            self._logger.warning(self._error, throttle_duration_sec=_WARNING_PERIOD_S)

    def status_lines(self) -> list[tuple[bytes, str]]:
        """Returns why the last result is not in the log; nothing if it is."""
        return [(WARN, self._error)] if self._error else []


def result_line(count: StackCount, volume: StackVolume) -> dict[str, Any]:
    """Returns the line of a count: the keys of `replay --json`, and whose count it is."""
    seconds, nanoseconds = divmod(stamp_ns(count.header.stamp), 10**9)
    stamp = datetime.fromtimestamp(seconds, timezone.utc).replace(microsecond=nanoseconds // 1000)
    line = {"schema_version": SCHEMA_VERSION, "scan_id": count.scan_id,
            "stamp": stamp.isoformat(timespec="microseconds").replace("+00:00", "Z"),
            "region": count.region, "part": count.part, "verdict": _VERDICTS[count.verdict]}
    if count.error:
        tally = from_tally(count.views)
        return {**line, "count": None, "status": "error", "error": count.error,
                "views": {"received": tally.received, "used": tally.used,
                          "skipped": tally.skipped}, "reasons": list(count.reasons)}
    result = as_dict(from_stack_count(count, from_stack_volume(volume)), [])
    for key in ("counts", "cells_filling_levels", "filling_level_cell_count"):
        del result[key]  # what is long: running counts, and the cells of the overall level
    return {**line, **result}
