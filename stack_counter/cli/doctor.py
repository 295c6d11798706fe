# SPDX-License-Identifier: Apache-2.0
"""The command `stack-counter doctor`: why nothing comes, of a bag or of the live graph."""

from __future__ import annotations

import argparse
from pathlib import Path

from stack_counter.cli.common import add_config_argument, require_bag
from stack_counter.config import load_config
from stack_counter.errors import ScanError
from stack_counter.files import config_path


def add_doctor(commands: argparse._SubParsersAction) -> None:
    """Adds `doctor` to the commands of the command line."""
    doctor = commands.add_parser("doctor", help="why nothing comes, and what to change")
    what = doctor.add_mutually_exclusive_group()
    what.add_argument("bag", type=Path, nargs="?",
                      help="a recording; without one, what is published now is looked at")
    what.add_argument("--nodes", action="store_true",
                      help="only whether the three nodes are active, as for a health check")
    add_config_argument(doctor)
    doctor.set_defaults(run=_doctor)


def _doctor(options: argparse.Namespace) -> int:
    """Prints what came and what to change; refuses what cannot be counted."""
    from stack_counter.views.checkup.findings import advice_lines, refuse_stopping

    if options.nodes:
        return _check_nodes()
    config = load_config(options.config or config_path("stack_counter.yaml"))
    if options.bag is None:
        from stack_counter.ros.doctor import examine_graph

        lines, findings = examine_graph(config)
    else:
        from stack_counter.bag.doctor import examine_bag

        lines, findings = examine_bag(require_bag(options.bag), config)
    print("\n".join([*lines, *advice_lines(findings)]))
    refuse_stopping(findings)
    return 0


def _check_nodes() -> int:
    """Prints the states of the three nodes.

    Raises:
        ScanError: one of them is not active.
    """
    from stack_counter.ros.graph_findings import node_findings
    from stack_counter.ros.node_states import examine_nodes

    states = examine_nodes()
    print(", ".join(f"{name} {state}" for name, state in states.items()))
    findings = node_findings(states)
    if findings:
        raise ScanError(str(findings[0]))
    return 0
