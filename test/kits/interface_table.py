# SPDX-License-Identifier: Apache-2.0
"""The table of topics, services and actions in docs/interface.md."""

from pathlib import Path

SPACE = "/stack_counter"
TABLE = Path(__file__).parents[2] / "docs" / "interface.md"


def table():
    """(node, how, name, type) of each row."""
    rows = [line.split("|")[1:5] for line in TABLE.read_text().splitlines()
            if line.startswith("| ") and not line.startswith("| node")]
    return {tuple(cell.strip().strip("`") for cell in row) for row in rows}


def full(name):
    return name if name.startswith("/") else f"{SPACE}/{name}"
