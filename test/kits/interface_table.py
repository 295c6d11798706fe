# SPDX-License-Identifier: Apache-2.0
"""The tables of topics, services and actions in docs/interface.md."""

import re
from pathlib import Path

SPACE = "/stack_counter"
TABLE = Path(__file__).parents[2] / "docs" / "interface.md"
NODES = ("collector", "reconstructor", "counter")
SUPERVISOR = "supervisor"  # has a table of its own


def _rows():
    """The cells of each row, without those of other tables."""
    rows = [[cell.strip().strip("`") for cell in line.split("|")[1:-1]]
            for line in TABLE.read_text().splitlines()
            if line.startswith("| ") and not line.startswith("| node")]
    return [row for row in rows if len(row) == 5]


def table(nodes=NODES):
    """(node, how, name, type) of each row of these nodes."""
    return {tuple(row[:4]) for row in _rows() if row[0] in nodes}


def latched():
    """Full names of the topics that are published latched."""
    return {full(name) for _, how, name, _, note in _rows()
            if how == "publishes" and re.search(r"(?<!not )latched", note)}


def full(name):
    return name if name.startswith("/") else f"{SPACE}/{name}"
