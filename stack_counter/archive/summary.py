# SPDX-License-Identifier: Apache-2.0
"""One page about the counts of a run: what changed first, then counts over time, then all."""

from __future__ import annotations

import os
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from stack_counter import __version__
from stack_counter.archive.bag_counter import utc_now
from stack_counter.archive.changes import Change, find_changes
from stack_counter.archive.count_chart import CountChart, draw_counts
from stack_counter.archive.outcome import Outcome
from stack_counter.archive.tables import CSV, PARQUET
from stack_counter.display.page.viewer import page_style
from stack_counter.files import write_atomically

PAGE = "summary.html"
# Nothing is fetched, and nothing runs.
_POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


@dataclass(frozen=True)
class SummarySettings:
    """How long the page gets.

    Attributes:
        max_rows: rows of its longest table; chosen: a page of some 2 MB, the tables have all.
    """

    max_rows: int = 2000


SETTINGS = SummarySettings()


def write_summary(folder: Path, outcomes: Sequence[Outcome], history: Sequence[Outcome]) -> None:
    """Writes summary.html.

    Args:
        folder: of the results.
        outcomes: that the page is about.
        history: all outcomes of the folder, in the order in which they came.

    Raises:
        OSError: it cannot be written.
    """
    changes = find_changes(outcomes, history)
    rows = [(outcome, line) for outcome in sorted(outcomes, key=lambda outcome: outcome.bag)
            for line in outcome.results]
    page = _environment().get_template("summary.html.j2").render(
        style=page_style(), policy=_POLICY, version=__version__, written=utc_now(),
        rows=rows, max_rows=SETTINGS.max_rows, changes=changes, charts=_charts(rows, changes),
        states=Counter(line["status"] for _, line in rows),
        failed=[(outcome, line) for outcome, line in rows if line["exit_code"]],
        compared={change.before.version for change in changes},
        seconds=_mean_seconds(rows), common=_common_folder(outcomes), tables=(CSV, PARQUET))
    write_atomically(folder / PAGE, page)


def _environment() -> Environment:
    return Environment(loader=FileSystemLoader(Path(__file__).parent), autoescape=True,
                       undefined=StrictUndefined, trim_blocks=True, lstrip_blocks=True)


def _charts(rows: Sequence[tuple[Outcome, dict[str, Any]]], changes: Sequence[Change]
            ) -> list[CountChart]:
    """A drawing for each part of which something was counted, in the order of their names."""
    changed = {(change.outcome.bag, change.line.get("region", "")) for change in changes}
    by_part: dict[str, list[tuple[dict[str, Any], bool]]] = {}
    for outcome, line in rows:
        if line["count"] is not None:
            is_new = (outcome.bag, line.get("region", "")) in changed
            by_part.setdefault(line["part"], []).append((line, is_new))
    return [draw_counts(part, *zip(*counts)) for part, counts in sorted(by_part.items())]


def _mean_seconds(rows: Sequence[tuple[Outcome, dict[str, Any]]]) -> float:
    seconds = [line["seconds"]["total"] for _, line in rows if line["count"] is not None]
    return sum(seconds) / max(len(seconds), 1)


def _common_folder(outcomes: Sequence[Outcome]) -> str:
    """The deepest folder that holds all bags, which the rows leave out; with a slash."""
    folders = [str(Path(outcome.bag).parent) for outcome in outcomes]
    return f"{os.path.commonpath(folders).rstrip('/')}/" if folders else ""
