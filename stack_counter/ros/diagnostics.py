# SPDX-License-Identifier: Apache-2.0
"""What an operator reads of a node: OK, WARN or ERROR, one line, and values by name."""

from __future__ import annotations

import math
import os
import time
from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_PAGE_BYTES = os.sysconf("SC_PAGE_SIZE")
_START_TIME = 19  # its place in /proc/self/stat behind the name of the process


@dataclass(frozen=True)
class RateSettings:
    """How a rate is measured.

    Attributes:
        window_s: seconds over which events are counted. Chosen: some images of a slow camera.
        max_events: number of events remembered. Chosen: 200 Hz over the window.
    """

    window_s: float = 5.0
    max_events: int = 1000


SETTINGS = RateSettings()


class Rate:
    """How often an event happens, how old its data is, and how long ago the last one was."""

    def __init__(self) -> None:
        """Starts without events."""
        self._times: deque[float] = deque(maxlen=SETTINGS.max_events)
        self.latency_s = 0.0
        self.count = 0

    def tick(self, latency_s: float = 0.0) -> None:
        """Records one event now; `latency_s` is the age of its data."""
        self._times.append(time.monotonic())
        self.latency_s = latency_s
        self.count += 1

    @property
    def hz(self) -> float:
        """Events per second over the last seconds."""
        begin = time.monotonic() - SETTINGS.window_s
        return sum(t >= begin for t in self._times) / SETTINGS.window_s

    @property
    def silent_s(self) -> float:
        """Seconds since the last event; infinite before the first."""
        return time.monotonic() - self._times[-1] if self._times else float("inf")


def memory_mb() -> float:
    """Returns the resident memory of this process, MB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * _PAGE_BYTES / 1e6


def data_age_s(now_ns: int, stamp_ns: int) -> float:
    """Age of data by a node's clock, seconds; NaN where that one waits for /clock and is 0."""
    return (now_ns - stamp_ns) * 1e-9 if now_ns else math.nan


def process_age_s() -> float:
    """Returns the time since this process was started, imports included, seconds."""
    with open("/proc/self/stat", encoding="ascii", errors="replace") as file:
        ticks = int(file.read().rpartition(")")[2].split()[_START_TIME])
    return time.clock_gettime(time.CLOCK_BOOTTIME) - ticks / os.sysconf("SC_CLK_TCK")


def summarize(lines: Iterable[tuple[bytes, str]]) -> tuple[bytes, str]:
    """Returns the worst level of some lines and their texts at that level; OK and `ok` of none."""
    lines = list(lines)
    worst = max((level for level, _ in lines), default=OK)
    texts = [text for level, text in lines if level == worst and text]
    return worst, "; ".join(texts) or "ok"


def to_array(name: str, level: bytes, message: str, values: Mapping[str, object], header: Header
             ) -> DiagnosticArray:
    """Returns the diagnostics message of one node.

    Args:
        name: of the node.
        level: OK, WARN or ERROR.
        message: one line.
        values: shown by name, floats with three digits.
        header: stamp of the message.
    """
    texts = {key: f"{value:.3g}" if isinstance(value, float) else str(value)
             for key, value in values.items()}
    status = DiagnosticStatus(
        name=f"stack_counter: {name}", hardware_id="", level=level, message=message,
        values=[KeyValue(key=key, value=text) for key, text in texts.items()])
    return DiagnosticArray(header=header, status=[status])
