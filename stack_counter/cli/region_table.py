# SPDX-License-Identifier: Apache-2.0
"""Counts of several regions as a table, as JSON, and as a folder of reports."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from stack_counter.bag.replayed import Replayed
from stack_counter.display.page.subject import ReportSubject
from stack_counter.display.report import as_dict, container_text, write_report
from stack_counter.display.result_schema import SCHEMA_VERSION
from stack_counter.types import Reason, StackCount


def regions_as_text(results: Sequence[Replayed]) -> str:
    """Returns a table with a line for each region, and below it a sentence for each reason."""
    width = max(len("region"), *(len(result.region) for result in results))
    lines = [f"{'region':<{width}}  count  interval        V cm3  status    container"]
    reasons: dict[Reason, list[str]] = {}
    for result in results:
        lines.append(f"{result.region:<{width}}  " + _cells(result))
        for reason in result.count.reasons if result.count is not None else ():
            reasons.setdefault(reason, []).append(result.region)
    return "\n".join([*lines, *(f"  {reason} ({', '.join(names)}): {reason.sentence}"
                                for reason, names in reasons.items())])


def _cells(result: Replayed) -> str:
    """Returns a result without its name; of a region without a count, the reason."""
    count = result.count
    if count is None:
        return f"    -  no count: {result.error}"
    low, high = count.count_interval
    return (f"{count.count:>5}  {f'{low} to {high}':<12}  {1e6 * count.volume.stack_volume:>7.1f}"
            f"  {count.status:<8}  {container_text(count.volume.container)}")


def regions_as_dict(results: Sequence[Replayed]) -> dict[str, Any]:
    """Returns the JSON object of `stack-counter replay --json` where regions are configured.

    Its key `regions` lists for each its `name` and what `report.as_dict` says of one count;
    of a region without a count `count` is null, and `error` says why.
    """
    return {"schema_version": SCHEMA_VERSION,
            "regions": [{"name": result.region, **_as_dict(result)} for result in results]}


def _as_dict(result: Replayed) -> dict[str, Any]:
    if result.count is None:
        return {"count": None, "status": "error", "error": result.error}
    return as_dict(result.count, result.counts)


def write_region_reports(folder: Path, results: Sequence[Replayed],
                         subject_of: Callable[[StackCount], ReportSubject]) -> None:
    """Writes result.json of all regions, and a report of each in a folder of its name below.

    Args:
        folder: made where it does not exist; files of the same names are replaced.
        results: of all regions.
        subject_of: what the report of a count names beside it.

    Raises:
        OSError: a folder cannot be written.
    """
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "result.json").write_text(json.dumps(regions_as_dict(results), indent=2) + "\n")
    for result in results:
        if result.count is not None:
            write_report(folder / result.region, result.count, result.counts,
                         subject_of(result.count))
