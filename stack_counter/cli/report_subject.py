# SPDX-License-Identifier: Apache-2.0
"""What a report says beside the count: the recording, the part, the verdict and the settings."""

from __future__ import annotations

from pathlib import Path

from stack_counter.config import Config
from stack_counter.counting import verdict
from stack_counter.display.page.subject import ReportSubject
from stack_counter.parts.catalogue import Part
from stack_counter.types import StackCount


def report_subject(bag: Path, config: Config, part: Part, count: StackCount,
                   true_count: int | None = None) -> ReportSubject:
    """Returns what a report of a replayed bag is of.

    Args:
        bag: that was replayed.
        config: settings that it was counted with.
        part: what is in the bin.
        count: final count.
        true_count: number of parts that are really there; None where nobody knows.
    """
    wanted, tolerance = config.counter.expected_count, config.counter.tolerance
    return ReportSubject(
        scan=bag.resolve().name, part=part.name,
        verdict=verdict(count.count_interval, wanted, tolerance),
        expected=f"expected {wanted} ± {tolerance}" if wanted else "",
        true_count=true_count, settings=vars(config))
