# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter`.

Exit codes: 0 a count (0 for an empty container is one); 2 the command line, part, configuration
or a path that is not there; 3 a bag that cannot give a count, with one line on stderr; 130 Ctrl-C.
"""

from __future__ import annotations

import argparse
import logging
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path

from stack_counter import __version__
from stack_counter.cli.bridge import add_bridge
from stack_counter.cli.common import add_config_argument, add_time_arguments, chosen_time_range
from stack_counter.cli.containers import add_container
from stack_counter.cli.doctor import add_doctor
from stack_counter.cli.import_scene import add_import
from stack_counter.cli.parts import add_part
from stack_counter.cli.play import add_play
from stack_counter.cli.recount import add_recount
from stack_counter.cli.replay import add_replay
from stack_counter.cli.run import add_run
from stack_counter.cli.simulate import add_simulate
from stack_counter.cli.view import add_view
from stack_counter.config import load_config
from stack_counter.errors import StackCounterError, exit_code_of, naming_missing_packages
from stack_counter.eval.arguments import ADD_ARGUMENTS
from stack_counter.files import config_path
from stack_counter.train.arguments import add_train_arguments

_INTERRUPTED = 130
_EVALUATIONS = {
    "gamma": "of gamma, beside the baselines",
    "count": "of the whole count and its interval",
    "real": "of counts of real scenes that somebody has counted",
    "live": "of the running count while parts are taken out",
    "robustness": "of counts of scans made hard on purpose: right, honest or wrong without a word",
    "parts": "of counts where the part's CAD file or a counted bin is known",
    "acceptance": "which solids of a library `part add` takes",
    "template": "of v from pieces on a table",
    "visible": "of the parts that show, located one by one",
    "volume": "of V and the container",
    "weight": "of counts where a scale is under the container, and of wrong bins on it",
    "labels": "of the labels that segmenters give",
    "images": "of V from pictures and labels, without depth",
    "surface": "of the surface that stereo gives: its depth and its power spectrum",
    "benchmark": "of V beside the published rule, and cost",
}


def main(arguments: list[str] | None = None) -> int:
    """Runs the command; returns its exit code."""
    # Skipped views are counted in the result; one line on stderr is for what ends the command.
    logging.basicConfig(level=logging.ERROR, format="%(message)s", stream=sys.stderr)
    try:
        options = _make_parser().parse_args(arguments)
        with _interrupted_by_sigterm(), naming_missing_packages():
            return options.run(options)
    except (StackCounterError, OSError) as error:
        return _report_error(error)
    except KeyboardInterrupt:
        return _INTERRUPTED


@contextmanager
def _interrupted_by_sigterm() -> Iterator[None]:
    """Has SIGTERM do what Ctrl-C does: what was started is ended, and what is open is closed."""
    if threading.current_thread() is not threading.main_thread():
        yield  # signals are the main thread's
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def _report_error(error: Exception) -> int:
    print(f"stack-counter: {' '.join(str(error).split())}", file=sys.stderr)
    return exit_code_of(error)


def _make_parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="stack-counter", description=(
        "Counts identical parts stacked in a bin from a few posed views."))
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    add_replay(commands)
    add_recount(commands)
    add_run(commands)
    add_view(commands)
    add_play(commands)
    add_bridge(commands)
    add_import(commands)
    _add_info(commands)
    add_doctor(commands)
    add_container(commands)
    add_part(commands)
    add_simulate(commands)
    train = commands.add_parser("train", help="train the gamma-network on simulated scenes")
    add_train_arguments(train)
    train.set_defaults(run=partial(_run_module, "stack_counter.train.gamma"))
    evaluate = commands.add_parser("evaluate", help="measure errors on simulated scenes")
    kinds = evaluate.add_subparsers(required=True, metavar="KIND")
    for kind, text in _EVALUATIONS.items():
        evaluation = kinds.add_parser(kind, help=text)
        ADD_ARGUMENTS[kind](evaluation)
        evaluation.set_defaults(run=partial(_run_module, f"stack_counter.eval.{kind}"))
    return parser


def _run_module(module: str, options: argparse.Namespace) -> int:
    """Runs a command's module, loaded only now: its libraries take seconds."""
    return import_module(module).run(options)


def _add_info(commands: argparse._SubParsersAction) -> None:
    info = commands.add_parser("info", help="topics, frames, views and problems of a bag")
    info.add_argument("bag", type=Path)
    add_config_argument(info)
    add_time_arguments(info)
    info.set_defaults(run=_info)


def _info(options: argparse.Namespace) -> int:
    from stack_counter.bag.info import describe_bag
    from stack_counter.views.checkup.findings import refuse_stopping

    config = load_config(options.config or config_path("stack_counter.yaml"))
    text, findings = describe_bag(options.bag, config, chosen_time_range(options))
    print(text)
    refuse_stopping(findings)
    return 0


if __name__ == "__main__":
    sys.exit(main())
