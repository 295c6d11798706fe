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
from pathlib import Path

from stack_counter.sim.reality.experiments import EXPERIMENTS
from stack_counter.sim.reality.plot import draw_plot
from stack_counter.sim.reality.run import run_comparisons, run_experiments
from stack_counter.sim.reality.table import (
    PageError,
    check_page,
    markdown_table,
    summarize,
    write_into_page,
)


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs the experiments and the comparisons, prints them and writes the page."""
    options = _parse(arguments)
    chosen = [i for i, experiment in enumerate(EXPERIMENTS) if not options.items
              or any(word.lower() in experiment.name.lower() for word in options.items)]
    if not chosen:
        print(f"no experiment has {options.items} in its name; expected words of "
              f"{', '.join(e.name for e in EXPERIMENTS)}", file=sys.stderr)
        return 2
    if options.page:  # before an hour is spent
        try:
            check_page(options.page)
        except PageError as error:
            print(error, file=sys.stderr)
            return 2
    rows = run_experiments(chosen, options.seeds, options.workers, options.friction)
    print("\n".join(summarize(rows)))
    others = [] if options.items else run_comparisons(options.workers)
    if options.page:
        draw_plot(rows, options.page.with_suffix(".png"))
        write_into_page(options.page, "\n".join([
            f"{options.seeds} piles a row.", "", markdown_table(rows), "",
            *(f"- {line}" for line in [*summarize(rows), *others])]))
    return 0


def _parse(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m stack_counter.sim.reality",
                                     description="Published packings, simulated and compared.")
    parser.add_argument("--seeds", type=int, default=3, help="piles of each experiment")
    parser.add_argument("--items", nargs="+", default=[], metavar="WORD",
                        help="only experiments with one of these in their name")
    parser.add_argument("--friction", type=float,
                        help="of all piles; by default that of the experiment's pour")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--page", type=Path, help="page whose table, and the plot beside it, are "
                                                  "written anew")
    return parser.parse_args(arguments)


if __name__ == "__main__":
    sys.exit(main())
