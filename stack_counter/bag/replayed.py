# SPDX-License-Identifier: Apache-2.0
"""What the replay of a bag gives: a result for each region, or the error of those without."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

from stack_counter.errors import ScanError
from stack_counter.types import StackCount, ViewTally


@dataclass(frozen=True, eq=False)
class Replayed:
    """What the replay of a bag gives for one region.

    Attributes:
        count: the final one; None where the region gives none.
        counts: `{stamp_ns, count, count_interval}`, one for each view used in continuous mode,
            one for each cycle in cycle mode.
        errors: one line for each cycle that gave no count; the reason where `count` is None.
        region: its name; empty where the settings name none.
    """

    count: StackCount | None
    counts: list[dict[str, Any]] = field(default_factory=list)
    errors: tuple[str, ...] = ()
    region: str = ""


def require_count(results: Iterable[Replayed]) -> list[Replayed]:
    """Returns the results of all regions.

    Raises:
        ScanError: none of them has a count; the message has the reason of each.
    """
    results = list(results)
    if any(result.count is not None for result in results):
        return results
    raise ScanError("; ".join(f"region {result.region}: {result.errors[0]}" if result.region
                              else result.errors[0] for result in results))


def count_entry(count: StackCount) -> dict[str, Any]:
    """One entry of the JSON key `counts`."""
    missing = list(count.volume.missing_cameras)
    return {"stamp_ns": count.volume.stamp_ns, "count": count.count,
            "count_interval": list(count.count_interval),
            **({"missing_cameras": missing} if missing else {})}


def no_count_line(error: str, tally: ViewTally, hints: list[str]) -> str:
    """One line that says why a bag gives no count, with what became of its images."""
    return "; ".join([error, f"{tally.received} images in the bag, skipped {tally.skipped}",
                      *hints])
