# SPDX-License-Identifier: Apache-2.0
"""Whether a wrong count ever comes without a word, on scans that are made hard on purpose.

stack-counter evaluate robustness
stack-counter evaluate robustness --only 42           # one scan, whose outcome it prints
"""

from __future__ import annotations

import argparse
from collections import Counter
from contextlib import suppress
from dataclasses import dataclass
from functools import cache

from stack_counter.config import CounterConfig
from stack_counter.errors import ConfigError, StackCounterError, ViewError
from stack_counter.eval.common.figures_file import write_figures
from stack_counter.eval.common.sets import find_set_folder
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.parts.catalogue import Part
from stack_counter.pipeline import StackCounter
from stack_counter.sim import (
    HARD_KINDS,
    HardScan,
    Scene,
    hard_kind,
    make_hard_scan,
    read_piles,
)
from stack_counter.tasks.progress import progress
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.types import StackCount


@dataclass(frozen=True)
class OutcomeSettings:
    """When an interval says nothing; chosen.

    Attributes:
        confidence: of the intervals.
        widest: width over the true count above which an interval is vague.
        few: true count below which the width is measured by this number instead.
    """

    confidence: float = 0.9
    widest: float = 2.0
    few: int = 3


SETTINGS = OutcomeSettings()
OUTCOMES = {
    "right": "the interval holds the true count",
    "honest": "refused, or degraded",
    "vague": "ok, and the interval holds the true count but says nothing",
    "wrong": "ok, and the interval does not hold the true count",
}


@dataclass(frozen=True)
class Outcome:
    """What the counter made of one scan.

    Attributes:
        number, kind, what: of the scan.
        true: parts that are asked for.
        outcome: a key of `OUTCOMES`.
        count, low, high: the answer and its interval; None where the scan was refused.
        status: `ok`, `degraded` or `refused`.
        why: reasons of the answer, or why the scan was refused.
    """

    number: int
    kind: str
    what: str
    true: int
    outcome: str
    count: int | None
    low: int | None
    high: int | None
    status: str
    why: str


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    if options.kind not in (None, *HARD_KINDS):
        raise ConfigError(f"--kind {options.kind}; expected one of: {', '.join(HARD_KINDS)}")
    numbers = [n for n in range(options.scenes) if options.kind in (None, hard_kind(n))] \
        if options.only is None else [options.only]
    jobs = [(options.set, options.seed, number) for number in numbers]
    outcomes = list(progress(map_tasks(_count_job, jobs, Workers.of(options)), "counts", "scans",
                             len(jobs)))
    for outcome in outcomes:
        if outcome.outcome in ("vague", "wrong") or options.only is not None:
            print(_format_outcome(outcome))
    print(f"{len(outcomes)} scans made hard from piles of {options.set}, seed {options.seed}\n"
          + format_table(outcomes))
    if options.json:
        write_figures(options.json, outcomes)
    return 0


def _count_job(job: tuple[str, int, int]) -> Outcome:
    """Makes one scan (set, seed, number) and counts it."""
    name, seed, number = job
    scan = make_hard_scan(seed, number, _read_piles(name))
    return count_hard_scan(scan, number, _load_estimator())


@cache
def _read_piles(name: str) -> list[Scene]:
    return read_piles(find_set_folder(name))


@cache
def _load_estimator() -> OccupancyEstimator:
    return make_estimator(CounterConfig())


def count_hard_scan(scan: HardScan, number: int, estimator: OccupancyEstimator) -> Outcome:
    """Counts a scan as `replay --direct` does, and judges the answer."""
    kind, count, refused = hard_kind(number), None, ""
    try:
        counter = StackCounter(scan.config, scan.unit_volume)
        for view in scan.views:
            with suppress(ViewError):  # skipped and counted, as everywhere
                counter.add_view(view)
        count = counter.count(Part(scan.unit_volume), estimator, SETTINGS.confidence)
    except StackCounterError as error:
        refused = str(error)
    if count is None:
        return Outcome(number, kind, scan.what, scan.count, "honest", None, None, None, "refused",
                       refused)
    low, high = count.count_interval
    return Outcome(number, kind, scan.what, scan.count, judge(count, scan.count), count.count, low,
                   high, count.status, ", ".join(map(str, count.reasons)))


def judge(count: StackCount, true: int) -> str:
    """The outcome, a key of `OUTCOMES`, of an answer to a scan of `true` parts."""
    low, high = count.count_interval
    holds = low <= true <= high
    says_something = high - low <= SETTINGS.widest * max(true, SETTINGS.few)
    if count.status != "ok":
        return "right" if holds and says_something else "honest"
    if not holds:
        return "wrong"
    return "right" if says_something else "vague"


def format_table(outcomes: list[Outcome]) -> str:
    """Number of each outcome by kind and of all, and the share that is wrong without a word."""
    lines = [f"{'':17}{'scans':>6}" + "".join(f"{name:>8}" for name in OUTCOMES)
             + f"{'wrong without a word':>22}"]
    groups = {**{kind: [o for o in outcomes if o.kind == kind] for kind in HARD_KINDS},
              "all": outcomes}
    for name, group in groups.items():
        if group:
            number = Counter(o.outcome for o in group)
            lines.append(f"{name:17}{len(group):6}" + "".join(f"{number[o]:8}" for o in OUTCOMES)
                         + f"{number['wrong'] / len(group):22.1%}")
    return "\n".join([*lines, *(f"{name}: {what}" for name, what in OUTCOMES.items())])


def _format_outcome(o: Outcome) -> str:
    answer = o.status if o.count is None else f"{o.count} [{o.low} to {o.high}], {o.status}"
    return (f"scan {o.number}, {o.kind}, {o.what}: {o.true} parts, {o.outcome}: {answer}"
            + (f" ({o.why})" if o.why else ""))
