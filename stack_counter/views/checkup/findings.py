# SPDX-License-Identifier: Apache-2.0
"""What was found wrong, and what to change."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from enum import IntEnum

from stack_counter.errors import ScanError


class Severity(IntEnum):
    """How much a finding matters to a count; the worst is the smallest."""

    STOPS = 0
    HARMS = 1


@dataclass(frozen=True)
class Finding:
    """One thing that is wrong.

    Attributes:
        severity: what it does to a count.
        text: what was seen and what is expected, a sentence without its full stop.
        remedy: what to change; empty where the text says it.
    """

    severity: Severity
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        """The finding on one line."""
        return f"{self.text} -> {self.remedy}" if self.remedy else self.text


def cause_first(findings: Iterable[Finding]) -> list[Finding]:
    """Findings of which the worst come first; of equal ones, in the order they are given in."""
    return sorted(dict.fromkeys(findings), key=lambda finding: finding.severity)


def stops_count(findings: Iterable[Finding]) -> bool:
    """Whether there is no count for one of these findings."""
    return any(finding.severity == Severity.STOPS for finding in findings)


def refuse_stopping(findings: Iterable[Finding]) -> None:
    """Refuses what cannot be counted.

    Raises:
        ScanError: one of the findings stops a count; the first of them.
    """
    for finding in cause_first(findings)[:1]:
        if finding.severity == Severity.STOPS:
            raise ScanError(str(finding))


def advice_lines(findings: Iterable[Finding]) -> list[str]:
    """What is wrong and what to change, cause first, a line each below a heading."""
    lines = [f"  {i}. {finding}" for i, finding in enumerate(cause_first(findings), 1)]
    return ["what to change", *lines] if lines else ["nothing to change: this can be counted"]
