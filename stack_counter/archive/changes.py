# SPDX-License-Identifier: Apache-2.0
"""Which results are others than those that the same bags had before."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

from stack_counter.archive.outcome import Outcome


@dataclass(frozen=True)
class Change:
    """A result that is another than before by more than its interval, or than none.

    Attributes:
        outcome: of now.
        line: the result of now.
        before: outcome with which it is compared.
        line_before: its result for the same region.
    """

    outcome: Outcome
    line: dict[str, Any]
    before: Outcome
    line_before: dict[str, Any]

    @property
    def size(self) -> float:
        """Difference of the counts over half the width of the wider interval.

        Infinite where one of them is no count.
        """
        if self.line["count"] is None or self.line_before["count"] is None:
            return float("inf")
        widths = [line["count_interval"][1] - line["count_interval"][0]
                  for line in (self.line, self.line_before)]
        return abs(self.line["count"] - self.line_before["count"]) / max(max(widths) / 2, 0.5)


def find_changes(now: Iterable[Outcome], history: Iterable[Outcome]) -> list[Change]:
    """Results that changed since the last time that the same recordings were counted otherwise.

    Otherwise is: by another version, by other settings, or with another knowledge of the part. A
    change is a count that lies outside the interval of the other, or one where there was none, or
    none where there was one.

    Args:
        now: outcomes that are compared.
        history: all outcomes, in the order in which they came.

    Returns:
        Changes, the largest first: those without a count now before all.
    """
    by_bag: dict[tuple[str, str], list[Outcome]] = {}
    for outcome in history:
        if outcome.is_final and outcome.key:
            by_bag.setdefault((outcome.bag, outcome.digest), []).append(outcome)
    changes = [change for outcome in now if outcome.key
               for change in _changes_of(outcome, by_bag.get((outcome.bag, outcome.digest), []))]
    return sorted(changes, key=lambda change: (change.line["count"] is not None, -change.size,
                                               change.outcome.bag))


def _changes_of(outcome: Outcome, history: list[Outcome]) -> Iterator[Change]:
    """Changes of one bag against the last of its outcomes that is another's."""
    same_part = [other for other in history if other.key != outcome.key
                 and other.part[:1] == outcome.part[:1]]
    if not same_part:
        return
    before = same_part[-1]
    lines_before = {line.get("region", ""): line for line in before.results}
    for line in outcome.results:
        line_before = lines_before.get(line.get("region", ""))
        if line_before is not None and _differ(line, line_before):
            yield Change(outcome, line, before, line_before)


def _differ(a: dict[str, Any], b: dict[str, Any]) -> bool:
    if a["count"] is None or b["count"] is None:
        return (a["count"] is None) != (b["count"] is None)
    return not (_holds(a, b["count"]) and _holds(b, a["count"]))


def _holds(line: dict[str, Any], count: int) -> bool:
    low, high = line["count_interval"]
    return low <= count <= high
