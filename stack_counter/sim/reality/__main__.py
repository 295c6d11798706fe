# SPDX-License-Identifier: Apache-2.0
"""Simulates published packings as they were made, and compares.

    python -m stack_counter.sim.reality [--items WORD ...] [--page docs/simulator.md]

The friction comes from the range that the training sets draw from: its ends for the loosest and
the densest known state, its median for what is poured. That range was fitted on balls and dice;
everything else is predicted.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import as_completed
from pathlib import Path

from stack_counter.child_processes import worker_pool
from stack_counter.errors import StackCounterError
from stack_counter.progress import progress_bar
from stack_counter.sim.reality import nesting
from stack_counter.sim.reality.experiments import EXPERIMENTS
from stack_counter.sim.reality.piles import Pile, simulate_experiment
from stack_counter.sim.reality.plot import draw_plot
from stack_counter.sim.reality.table import Row, markdown_table, summarize, write_into_page


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the experiments and prints a row for each, then hulls against decompositions."""
    options = _parse(arguments)
    chosen = [i for i, experiment in enumerate(EXPERIMENTS) if not options.items
              or any(word.lower() in experiment.name.lower() for word in options.items)]
    if not chosen:
        print(f"no experiment has {options.items} in its name; expected words of "
              f"{', '.join(e.name for e in EXPERIMENTS)}", file=sys.stderr)
        return 2
    rows = run_experiments(chosen, options.seeds, options.workers)
    print("\n".join(summarize(rows)))
    hulls = [] if options.items else [_nesting_line(family) for family in nesting.SETTINGS.parts]
    if options.page:
        draw_plot(rows, options.page.with_suffix(".png"))
        write_into_page(options.page, "\n".join([
            f"{options.seeds} piles a row.", "", markdown_table(rows), "",
            *(f"- {line}" for line in [*summarize(rows), *hulls])]))
    return 0


def run_experiments(chosen: Sequence[int], seeds: int, workers: int) -> list[Row]:
    """Simulates so many piles of each of the `EXPERIMENTS`; prints each row when it is whole.

    What cannot be simulated is said on stderr and has no row.
    """
    piles: dict[int, list[Pile]] = {i: [] for i in chosen}
    rows: dict[int, Row] = {}
    with worker_pool(workers) as pool, \
            progress_bar("reality", "piles", len(chosen) * seeds) as advance:
        jobs = {pool.submit(_run_job, i, seed): i for i in chosen for seed in range(seeds)}
        for job in as_completed(jobs):
            i = jobs[job]
            advance()
            try:
                piles[i].append(job.result())
            except StackCounterError as error:
                print(error, file=sys.stderr)
                continue
            if len(piles[i]) == seeds:
                experiment = EXPERIMENTS[i]
                rows[i] = Row(experiment, experiment.measured_share(experiment.part()), piles[i])
                print(" | ".join(rows[i].cells()), flush=True)
    return [rows[i] for i in sorted(rows)]


def _run_job(index: int, seed: int) -> Pile:
    """One pile, in a process of the pool."""
    return simulate_experiment(EXPERIMENTS[index], seed)


def _nesting_line(family: str) -> str:
    """By how much hulls of a family stand higher than decompositions; printed as well."""
    convexity, excess = nesting.measure_nesting(family)
    line = f"{family} (convexity {convexity:.2f}): hulls stand {excess:+.1%} higher than " \
           "decompositions."
    print(line, flush=True)
    return line


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m stack_counter.sim.reality",
                                     description="Published packings, simulated and compared.")
    parser.add_argument("--seeds", type=int, default=3, help="piles of each experiment")
    parser.add_argument("--items", nargs="+", default=[], metavar="WORD",
                        help="only experiments with one of these in their name")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="page whose table, and the plot beside it, are "
                                                  "written anew")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
