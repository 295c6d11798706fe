"""What an operator reads of a node: OK, WARN or ERROR, one line, and figures."""

from __future__ import annotations

import os
import time
from collections import deque
from collections.abc import Mapping

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from std_msgs.msg import Header

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
_WINDOW_S = 5.0  # over which rates are taken
_MOST = 1000  # events remembered
_PAGE = os.sysconf("SC_PAGE_SIZE")


class Rate:
    """How often something happens, how late it comes, and when it came last."""

    def __init__(self) -> None:
        self._times: deque[float] = deque(maxlen=_MOST)
        self.latency_s = 0.0
        self.count = 0

    def tick(self, latency_s: float = 0.0) -> None:
        """It has just happened; `latency_s`: its age then."""
        self._times.append(time.monotonic())
        self.latency_s = latency_s
        self.count += 1

    @property
    def hz(self) -> float:
        """Per second, over the last seconds."""
        since = time.monotonic() - _WINDOW_S
        return sum(t >= since for t in self._times) / _WINDOW_S

    @property
    def silent_s(self) -> float:
        """Seconds since the last one; infinite before the first."""
        return time.monotonic() - self._times[-1] if self._times else float("inf")


def memory_mb() -> float:
    """Resident memory of this process, MB."""
    with open("/proc/self/statm", encoding="ascii") as file:
        return int(file.read().split()[1]) * _PAGE / 1e6


def worst(*findings: tuple[bytes, str]) -> tuple[bytes, str]:
    """The worst level of some findings, and what they say at that level; OK and `ok` for none."""
    level = max((found for found, _ in findings), default=OK)
    said = [text for found, text in findings if found == level and text]
    return level, "; ".join(said) or "ok"


def to_array(name: str, level: bytes, message: str, values: Mapping[str, object], header: Header
             ) -> DiagnosticArray:
    """The message of one node's status."""
    said = {key: f"{value:.3g}" if isinstance(value, float) else str(value)
            for key, value in values.items()}
    status = DiagnosticStatus(
        name=f"stack_counter: {name}", hardware_id="", level=level, message=message,
        values=[KeyValue(key=key, value=value) for key, value in said.items()])
    return DiagnosticArray(header=header, status=[status])
