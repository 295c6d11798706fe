# SPDX-License-Identifier: Apache-2.0
"""Counts the bags of an archive that have no result yet, and writes all results as tables."""

from __future__ import annotations

from collections.abc import Iterable
from concurrent.futures import Future
from dataclasses import dataclass, replace
from pathlib import Path

from stack_counter import __version__
from stack_counter.archive.bag_counter import BagCounter, BagTask, failed_outcome, utc_now
from stack_counter.archive.digests import bag_state, settings_digest, with_absolute_paths
from stack_counter.archive.journal import Journal
from stack_counter.archive.outcome import Outcome
from stack_counter.archive.summary import write_summary
from stack_counter.archive.tables import require_pyarrow, write_tables
from stack_counter.config import Config
from stack_counter.errors import StackCounterError
from stack_counter.tasks.progress import progress_bar
from stack_counter.tasks.workers import Workers, run_tasks
from stack_counter.types import PartRequest


@dataclass(frozen=True)
class Recount:
    """What to count, and how.

    Attributes:
        bags: absolute paths.
        out: folder of the results.
        config: settings.
        request: part of all bags; empty: what each recording names, else the settings.
        workers: where.
        reports: whether each count gets a report.
    """

    bags: tuple[Path, ...]
    out: Path
    config: Config
    request: PartRequest = PartRequest()
    workers: Workers = Workers()
    reports: bool = False


def recount(job: Recount) -> tuple[list[Outcome], int]:
    """Counts every bag without a result, and writes results.parquet, results.csv, summary.html.

    Returns:
        Outcomes of the bags in their order, those that were there as well; and how many were.

    Raises:
        ConfigError: the folder is in use, no cluster answers, or a package is not installed.
        OSError: the folder cannot be written.
        WeightsError, PartError: the settings name what cannot be loaded.
    """
    require_pyarrow()
    journal = Journal(job.out)
    try:
        counter = BagCounter(
            config=with_absolute_paths(job.config), request=job.request,
            settings=settings_digest(job.config), version=__version__, known=frozenset(),
            out=job.out.absolute(), reports=job.reports)
        there, missing = _sort_bags(job, counter, journal.outcomes)
        done = dict(there)
        try:
            _count(job, counter, missing, journal, done)
        finally:  # whatever ends the run, what it has counted can be read
            outcomes = [done[str(bag)] for bag in job.bags if str(bag) in done]
            write_tables(job.out, journal.outcomes)
            write_summary(job.out, outcomes, journal.outcomes)
    finally:
        journal.close()
    return outcomes, len(there)


def _sort_bags(job: Recount, counter: BagCounter, outcomes: Iterable[Outcome]
               ) -> tuple[dict[str, Outcome], list[BagTask]]:
    """Bags whose outcome is there by their path, and tasks for the others."""
    by_bag: dict[str, list[Outcome]] = {}
    for outcome in outcomes:
        by_bag.setdefault(outcome.bag, []).append(outcome)
    is_current = _CurrentOutcomes(job, counter)
    there, missing = {}, []
    for bag in job.bags:
        try:
            state = bag_state(bag)
        except (StackCounterError, OSError):  # its task will say why
            state = ""
        same = [o for o in by_bag.get(str(bag), ()) if state and o.state == state]
        current = [o for o in same if is_current(o)]
        if current:
            there[str(bag)] = current[-1]
        else:
            missing.append(BagTask(bag, state, same[-1].digest if same else ""))
    return there, missing


class _CurrentOutcomes:
    """Tells outcomes that would be the same again from others."""

    def __init__(self, job: Recount, counter: BagCounter):
        self._job, self._counter = job, counter
        self._part_digests: dict[PartRequest, str] = {}

    def __call__(self, outcome: Outcome) -> bool:
        if not outcome.is_final or (outcome.version, outcome.settings) != (
                self._counter.version, self._counter.settings):
            return False
        wanted = self._job.request
        if outcome.part:
            name, unit_volume, size = outcome.part
            request = PartRequest(name, unit_volume, tuple(size))
            if wanted.names_a_part and request != wanted:
                return False
            return self._digest_of(request) == outcome.part_digest and self._has_reports(outcome)
        return True  # a recording that cannot be opened

    def _digest_of(self, request: PartRequest) -> str:
        if request not in self._part_digests:
            try:
                self._part_digests[request] = self._counter.part_digest_of(request)
            except (StackCounterError, OSError):  # its task will say why
                self._part_digests[request] = ""
        return self._part_digests[request]

    def _has_reports(self, outcome: Outcome) -> bool:
        return not self._job.reports or all(
            line["exit_code"] or (self._job.out / line.get("report", "none")).is_file()
            for line in outcome.results)


def _count(job: Recount, counter: BagCounter, missing: list[BagTask], journal: Journal,
           done: dict[str, Outcome]) -> None:
    """Counts bags; their outcomes go into the journal and to those that are done."""
    by_key = {} if job.reports else {outcome.key: outcome for outcome in journal.outcomes
                                     if outcome.key and outcome.is_final}
    counter = replace(counter, known=frozenset(by_key))
    with progress_bar("recount", "bags", len(job.bags), len(done)) as advance:
        for task, future in run_tasks(counter, missing, job.workers):
            outcome = _outcome(task, future, counter)
            if outcome.key in by_key and not outcome.results:  # a copy of a bag, or one moved
                same = by_key[outcome.key]
                outcome = replace(outcome, exit_code=same.exit_code, results=same.results)
            journal.append(outcome)
            done[outcome.bag] = outcome
            advance()


def _outcome(task: BagTask, future: Future[Outcome], counter: BagCounter) -> Outcome:
    """The outcome of a task, or that of one whose worker was lost."""
    error = future.exception()
    if error is None:
        return future.result()
    if not isinstance(error, Exception):  # a worker was interrupted as well
        raise error
    return failed_outcome(Outcome(str(task.bag), counter.version, counter.settings, utc_now(),
                                  task.state, task.digest), error)
