# SPDX-License-Identifier: Apache-2.0
"""What a count is of, as far as the count itself does not say."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from stack_counter.config import Config
from stack_counter.counting import verdict
from stack_counter.types import Arrangement, StackCount


@dataclass(frozen=True, eq=False)
class ReportSubject:
    """What a report names beside its count.

    Attributes:
        scan: name of the scan or the recording.
        part: name of the part; empty where only its volume was given.
        verdict: against what was expected, as `counting.verdict` has it.
        expected: what was expected, in words; empty if nothing was.
        true_count: number of parts that are really there; None where nobody knows.
        settings: settings objects by the name of the node that they are of.
        arrangement: how the parts that no view shows may lie; None where none was simulated.
    """

    scan: str = ""
    part: str = ""
    verdict: str = "none"
    expected: str = ""
    true_count: int | None = None
    settings: Mapping[str, Any] = field(default_factory=dict)
    arrangement: Arrangement | None = None

    def setting_rows(self) -> list[tuple[str, str, str, bool]]:
        """Returns node, name and value of each setting, and whether it differs from the default.

        NaN, which stands for what is not set, differs from itself; its text does not.
        """
        return [(node, item.name, str(getattr(section, item.name)),
                 repr(getattr(section, item.name)) != repr(item.default))
                for node, section in self.settings.items()
                for item in dataclasses.fields(section)]


def report_subject(bag: Path, config: Config, part: str, count: StackCount,
                   true_count: int | None = None) -> ReportSubject:
    """Returns what a report of a replayed bag is of.

    Args:
        bag: that was replayed.
        config: settings that it was counted with.
        part: name of what is in the bin; empty where only its volume was given.
        count: final count.
        true_count: number of parts that are really there; None where nobody knows.
    """
    wanted, tolerance = config.counter.expected_count, config.counter.tolerance
    return ReportSubject(
        scan=bag.resolve().name, part=part,
        verdict=verdict(count.count_interval, wanted, tolerance),
        expected=f"expected {wanted} ± {tolerance}" if wanted else "",
        true_count=true_count, settings=vars(config))
