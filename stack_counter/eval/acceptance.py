# SPDX-License-Identifier: Apache-2.0
"""Which real solids `part add` takes: their convex pieces, and the piles that come to rest.

    stack-counter evaluate acceptance --library FILE --solids 200 --seed 0 --piles 8

A part is taken if it makes piles, and no more than 25 tries are thrown away for eight of them.
The piles are poured, not scanned, as that takes most of the time. `--json OUT` is written after
each solid; where it exists, its solids are not tried again, if as many piles were asked for, and
others stay in it.
"""

from __future__ import annotations

import argparse
import json
import time
from collections import Counter
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from stack_counter.config import Config
from stack_counter.errors import StackCounterError
from stack_counter.files import write_atomically
from stack_counter.sim import Shape, convex_pieces, measure_form, open_library
from stack_counter.tasks.progress import progress, write_line
from stack_counter.tasks.workers import Workers, map_tasks
from stack_counter.teaching import Pile, make_pile_request, simulate_part_piles


@dataclass(frozen=True)
class AcceptanceSettings:
    """When a part counts as taken; chosen.

    Attributes:
        max_failed_tries: tries thrown away for eight piles.
    """

    max_failed_tries: int = 25


SETTINGS = AcceptanceSettings()


@dataclass(frozen=True)
class PartCheck:
    """What became of one solid.

    Attributes:
        number, family: place in the library, and family.
        asked: number of piles asked for.
        pieces: number of convex pieces; 0 where there are none.
        fullness, protrusion: form of the pieces, as `sim.PieceForm` has it.
        pieces_s, piles_s: seconds of the decomposition and of all piles.
        piles: number of piles that came to rest.
        failed_tries: number of tries thrown away, by reason.
        refused: why the part was refused; empty if it was not.
    """

    number: int
    family: str
    asked: int = 0
    pieces: int = 0
    fullness: float = 1.0
    protrusion: float = 0.0
    pieces_s: float = 0.0
    piles_s: float = 0.0
    piles: int = 0
    failed_tries: dict[str, int] | None = None
    refused: str = ""

    @property
    def failed(self) -> int:
        """Number of tries thrown away."""
        return sum((self.failed_tries or {}).values())

    @property
    def taken(self) -> bool:
        """Whether it is taken, within the tries."""
        return not self.refused and self.failed <= SETTINGS.max_failed_tries


def run(options: argparse.Namespace) -> int:
    """Prints and writes the figures; returns the exit code."""
    library = open_library(options.library)
    order = np.random.default_rng(options.seed).permutation(len(library))[:options.solids]
    written = _read_checks(options.json)
    checks = [check for check in written
              if check.number in order and check.asked == options.piles]
    others = [check for check in written if check not in checks]
    done = {check.number for check in checks}
    left = [int(number) for number in order if number not in done]
    jobs = map_tasks(partial(check_part, library, piles=options.piles), left, Workers.of(options))
    for check in progress(jobs, "part add", "solids", len(left)):
        checks.append(check)
        if not check.taken:
            write_line(_format_check(check))
        if options.json:
            write_atomically(options.json, json.dumps(
                [asdict(check) for check in others + checks]) + "\n")
    print(format_table(checks))
    return 0


def _read_checks(path: Path | None) -> list[PartCheck]:
    """The solids that an earlier, interrupted run has written."""
    if path is None or not path.exists():
        return []
    return [PartCheck(**check) for check in json.loads(path.read_text())]


def check_part(library: list[Shape], number: int, piles: int) -> PartCheck:
    """Adds solid `number` of a library as a part, from so many piles, and writes nothing."""
    begin = time.monotonic()
    family, made = str(number), {}
    try:
        shape = library[number]
        family = shape.family
        pieces = convex_pieces(shape)
        form = measure_form(shape.mesh, pieces)
        cut = time.monotonic()
        made = {"pieces": len(pieces), "fullness": form.fullness, "protrusion": form.protrusion,
                "pieces_s": cut - begin}
        request = make_pile_request(shape.vertices, shape.faces, Config())
        done = simulate_part_piles(replace(request, scanned=False), piles, 1, lambda: None)
    except StackCounterError as error:
        return PartCheck(number, family, piles, **made, refused=str(error))
    return PartCheck(number, family, piles, **made, piles_s=time.monotonic() - cut,
                     piles=sum(pile.rests for pile in done),
                     failed_tries=_count_failed_tries(done))


def _count_failed_tries(piles: list[Pile]) -> dict[str, int]:
    return dict(sum((pile.count_failed_tries() for pile in piles), Counter()))


def _format_check(check: PartCheck) -> str:
    return f"{check.number} {check.family}, {check.pieces} pieces: " + (
        check.refused or f"{check.failed} tries thrown away: {check.failed_tries}")


def format_table(checks: list[PartCheck]) -> str:
    """The figures of all solids, in lines."""
    taken = [check for check in checks if check.taken]
    cut = [check for check in checks if check.pieces]
    failed = sum((Counter(check.failed_tries) for check in checks), Counter())
    lines = [f"{len(taken)} of {len(checks)} solids taken ({len(taken) / len(checks):.1%}), "
             f"{sum(bool(check.refused) for check in checks)} refused",
             f"tries thrown away: {failed.total()} for {sum(c.piles for c in checks)} piles, "
             f"{max(c.failed for c in checks)} at most for a solid; "
             + ", ".join(f"{n} {reason}" for reason, n in failed.most_common())]
    for name, values in (
            ("pieces", [c.pieces for c in cut]), ("fullness", [c.fullness for c in cut]),
            ("protrusion", [c.protrusion for c in cut]),
            ("decomposition, s", [c.pieces_s for c in cut]),
            ("piles of a solid, s", [c.piles_s for c in cut])):
        if values:
            low, middle, high = np.quantile(values, [0.5, 0.95, 1])
            lines.append(f"{name}: median {low:.3g}, 95% {middle:.3g}, most {high:.3g}")
    return "\n".join(lines)
