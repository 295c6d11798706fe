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
            one for each cycle in cycle mode; of a cycle without a count both are None, and
            `error` says why.
        error: why `count` is None, one line; empty where there is one.
        region: its name; empty where the settings name none.
        notes: what was found in the bag or assumed of its messages, a line each.
    """

    count: StackCount | None
    counts: list[dict[str, Any]] = field(default_factory=list)
    error: str = ""
    region: str = ""
    notes: tuple[str, ...] = ()


def require_count(results: Iterable[Replayed]) -> list[Replayed]:
    """Returns the results of all regions.

    Raises:
        ScanError: none of them has a count; the message has the reason of each.
    """
    results = list(results)
    if any(result.count is not None for result in results):
        return results
    raise ScanError("; ".join(f"region {result.region}: {result.error}" if result.region
                              else result.error for result in results))


def count_entry(count: StackCount) -> dict[str, Any]:
    """One entry of the JSON key `counts`."""
    missing = list(count.volume.missing_cameras)
    return {"stamp_ns": count.volume.stamp_ns, "count": count.count,
            "count_interval": list(count.count_interval),
            **({"missing_cameras": missing} if missing else {})}


def failed_cycle_entry(stamp_ns: int, error: str, missing_cameras: Iterable[str]
                       ) -> dict[str, Any]:
    """The entry of a cycle that gives no count.

    Args:
        stamp_ns: of its first view.
        error: why, one line.
        missing_cameras: names of the cameras that gave it no view.
    """
    missing = list(missing_cameras)
    return {"stamp_ns": stamp_ns, "count": None, "count_interval": None, "error": error,
            **({"missing_cameras": missing} if missing else {})}


def replayed_cycles(region: str, entries: list[dict[str, Any]], last: StackCount | None,
                    tally: ViewTally, hints: list[str]) -> Replayed:
    """What a bag of cycles gives for one region: one failed cycle takes nothing from the others.

    Args:
        region: its name; empty where the settings name none.
        entries: of all cycles.
        last: last of their counts; None where none has one.
        tally: of all images.
        hints: what else may be said where there is no count.
    """
    if last is not None:
        return Replayed(last, entries, region=region)
    why = "0 cycles; expected one or more"
    if entries:
        others = f"; none of {len(entries)} cycles gives a count" if len(entries) > 1 else ""
        why = f"cycle at {1e-9 * entries[0]['stamp_ns']:.3f} s: {entries[0]['error']}{others}"
    return Replayed(None, entries, no_count_line(why, tally, hints), region)


def no_count_line(error: str, tally: ViewTally, hints: list[str]) -> str:
    """One line that says why a bag gives no count, with what became of its images."""
    stood = ["a camera that stands still gives one view: set min_views to 1 for it"] \
        if 2 * tally.skipped.get("duplicate", 0) > tally.received else []
    advice = [*stood, "stack-counter doctor BAG says what to change"] if tally.skipped \
        or not tally.received else []
    return "; ".join([error, f"{tally.received} images in the bag, skipped {tally.skipped}",
                      *hints, *advice])
