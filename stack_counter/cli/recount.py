# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter recount`: counts every bag of an archive again."""

from __future__ import annotations

import argparse
from pathlib import Path

from stack_counter.cli.common import add_config_argument
from stack_counter.config import load_config
from stack_counter.files import config_path
from stack_counter.tasks.workers import Workers
from stack_counter.types import PartRequest


def add_recount(commands: argparse._SubParsersAction) -> None:
    """Adds `recount` to the commands of the command line."""
    recount = commands.add_parser(
        "recount", help="count every bag of an archive again",
        description="Counts all bags that have no result of this version, these settings and this "
                    "knowledge of the part yet; a run that was killed goes on where it was.")
    recount.add_argument("archive", type=Path, metavar="FOLDER|LIST",
                         help="folder with bags at any depth, or a text file with a path a line")
    recount.add_argument("--out", type=Path, required=True, metavar="RESULTS",
                         help="folder of the results: results.parquet, results.csv, summary.html")
    recount.add_argument("--part", default="", metavar="NAME",
                         help="part of the catalogue; default: what each recording of the "
                              "collector names, else the settings")
    add_config_argument(recount)
    Workers.add_arguments(recount)
    recount.add_argument("--report", action="store_true",
                         help="write the report page of every count as well")
    recount.set_defaults(run=_recount)


def _recount(options: argparse.Namespace) -> int:
    from stack_counter.archive.bag_search import find_bags
    from stack_counter.archive.recount import Recount, recount
    from stack_counter.archive.summary import PAGE
    from stack_counter.container.catalogue import configured_container
    from stack_counter.occupancy import make_estimator
    from stack_counter.parts.part_lookup import resolve_part

    # Refuse at once what would keep every bag from being counted.
    config = load_config(options.config or config_path("stack_counter.yaml"))
    request = PartRequest(options.part)
    if request.names_a_part:
        resolve_part(request, config.counter.part_catalogue)
    make_estimator(config.counter)
    configured_container(config.reconstructor)
    bags = find_bags(options.archive)
    # Count.
    outcomes, there = recount(Recount(tuple(bags), options.out, config, request,
                                      Workers.of(options), options.report))
    failed = sum(bool(outcome.exit_code) for outcome in outcomes)
    print(f"{len(outcomes)} bags: {len(outcomes) - failed} with a count, {failed} without; "
          f"{there} were there before\n{options.out / PAGE}")
    return 0
