# SPDX-License-Identifier: Apache-2.0
"""Counts one bag after the other with the same settings, in one process of a run."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any

from stack_counter import __version__
from stack_counter.archive.digests import bag_digest, bag_state, part_digest, result_key
from stack_counter.archive.outcome import Outcome
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replay import replay_direct
from stack_counter.bag.replayed import Replayed
from stack_counter.config import Config
from stack_counter.counting import verdict
from stack_counter.display.page.subject import report_subject
from stack_counter.display.report import as_dict, write_report
from stack_counter.display.result_schema import SCHEMA_VERSION
from stack_counter.errors import ConfigError, StackCounterError, exit_code_of
from stack_counter.occupancy import OccupancyEstimator, make_estimator
from stack_counter.parts.catalogue import Part, load_parts
from stack_counter.parts.part_lookup import configured_part, resolve_part
from stack_counter.types import PartRequest, StackCount

REPORTS = "reports"  # folder of the reports, below that of the results


@dataclass(frozen=True)
class BagTask:
    """A bag to count.

    Attributes:
        bag: absolute path.
        state: sizes and times of change of its files, when `digest` was made.
        digest: of its content; empty where it is not known yet.
    """

    bag: Path
    state: str = ""
    digest: str = ""


@dataclass(frozen=True)
class BagCounter:
    """Counts bags; what it has loaded for one, it has for the next.

    Attributes:
        config: settings.
        request: part of all bags; empty: what each recording names, else the settings.
        settings: digest of the settings and weights.
        version: of the package that has begun the run, and is to count everywhere.
        known: keys of the results that are there.
        out: folder of the results, the same for every machine.
        reports: whether each count gets a report.
    """

    config: Config
    request: PartRequest
    settings: str
    version: str
    known: frozenset[str]
    out: Path
    reports: bool = False

    def __call__(self, task: BagTask) -> Outcome:
        """Counts a bag; of one whose result is known, only the key is returned, and no results."""
        outcome = Outcome(str(task.bag), self.version, self.settings, utc_now())
        try:
            self._check_version()
            state = bag_state(task.bag)
            known_digest = task.digest if state == task.state else ""
            digest = known_digest or bag_digest(task.bag)
            outcome = replace(outcome, state=state, digest=digest)
            facts = BagReader(task.bag).facts
            part = resolve_part(request := self._request(facts), self._catalogue)
            known = part_digest(part)
            key = result_key(digest, self.version, self.settings, known)
            outcome = replace(outcome, part=(request.name, request.unit_volume,
                                             list(request.outer_size_m)),
                              part_digest=known, key=key)
            if key in self.known:
                return outcome
            results = replay_direct(task.bag, self.config, part, estimator=self._estimator)
            return replace(outcome, results=tuple(
                self._line(task.bag, facts.get("scan_id", ""), part, result, key)
                for result in results))
        except Exception as error:  # whatever it was, the other bags are counted
            return failed_outcome(outcome, error)

    def part_digest_of(self, request: PartRequest) -> str:
        """Digest of what is known of a part now.

        Raises:
            PartError, ConfigError, OSError: it cannot be looked up.
        """
        return part_digest(resolve_part(request, self._catalogue))

    @property
    def _catalogue(self) -> str:
        return self.config.counter.part_catalogue

    @cached_property
    def _estimator(self) -> OccupancyEstimator:
        return make_estimator(self.config.counter)

    def _check_version(self) -> None:
        if __version__ != self.version:
            raise ConfigError(f"stack_counter is {__version__} on this machine; expected "
                              f"{self.version}, as where the run began")

    def _request(self, facts: dict[str, str]) -> PartRequest:
        """Which part a bag is of: the one of all bags, the recording's, or that of the settings.

        Of a part that the catalogue has, what it says today holds, not what was recorded.
        """
        if self.request.names_a_part:
            return self.request
        name, unit_volume = facts.get("part", ""), float(facts.get("unit_volume_m3", 0.0))
        if name in load_parts(Path(self._catalogue) if self._catalogue else None):
            return PartRequest(name)
        if unit_volume:
            return PartRequest(name, unit_volume, tuple(
                map(float, facts.get("part_size_m", "0 0 0").split())))
        return configured_part(self.config.counter)

    def _line(self, bag: Path, scan_id: str, part: Part, result: Replayed, key: str
              ) -> dict[str, Any]:
        """The line of one region's result, and its report where one is wanted."""
        count = result.count
        line: dict[str, Any] = {"scan_id": scan_id, "region": result.region, "part": part.name}
        if count is None:
            return {**_error_line(3, result.error), **line}
        wanted = self.config.counter
        line |= {"schema_version": SCHEMA_VERSION, "stamp": iso_time(count.volume.stamp_ns),
                 "verdict": verdict(count.count_interval, wanted.expected_count,
                                    wanted.tolerance),
                 "exit_code": 0, **as_dict(count, [])}
        for key in ("counts", "cells_filling_levels", "filling_level_cell_count"):
            del line[key]  # what is long, as in `result_log`
        if self.reports:
            line["report"] = self._write_report(bag, part, result.region, count, key)
        return line

    def _write_report(self, bag: Path, part: Part, region: str, count: StackCount, key: str
                      ) -> str:
        """Writes a report; returns the page's path from the folder of results on."""
        folder = Path(REPORTS, f"{bag.stem}-{key}", region)
        write_report(self.out / folder, count, [],
                     report_subject(bag, self.config, part.name, count))
        return str(folder / "report.html")


def failed_outcome(outcome: Outcome, error: BaseException) -> Outcome:
    """The outcome of a bag that an error has kept from being counted."""
    text = " ".join(str(error).split())
    if not isinstance(error, (StackCounterError, OSError)):
        text = f"{type(error).__name__}: {text}; expected no such error: please report it"
    code = exit_code_of(error)
    part = {"part": outcome.part[0]} if outcome.part else {}
    return replace(outcome, exit_code=code, results=({**_error_line(code, text), **part},))


def utc_now() -> str:
    """The time now, ISO 8601, UTC."""
    return iso_time(round(datetime.now(UTC).timestamp()) * 10**9)


def iso_time(stamp_ns: int) -> str:
    """A time since 1970, ns, as ISO 8601 in UTC, to the microsecond."""
    seconds, nanoseconds = divmod(stamp_ns, 10**9)
    moment = datetime.fromtimestamp(seconds, UTC).replace(microsecond=nanoseconds // 1000)
    return moment.isoformat(timespec="microseconds").replace("+00:00", "Z")


def _error_line(code: int, text: str) -> dict[str, Any]:
    return {"schema_version": SCHEMA_VERSION, "count": None, "status": "error", "error": text,
            "exit_code": code}
