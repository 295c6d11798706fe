# SPDX-License-Identifier: Apache-2.0
"""The final counts of the counter, as lines of `result_log`."""

from __future__ import annotations

from pathlib import Path

from rclpy.impl.rcutils_logger import RcutilsLogger
from stack_counter_msgs.msg import StackCount, StackVolume

from stack_counter.config import CounterConfig
from stack_counter.display.result_log import ResultLog
from stack_counter.ros.diagnostics import WARN
from stack_counter.ros.result_line import result_line

_WARNING_PERIOD_S = 60.0  # between two warnings


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
