# SPDX-License-Identifier: Apache-2.0
"""Parameter files of a node's command line that call the nodes by their bare names.

ROS 2 takes `collector:` for a node without a namespace, and ours have one: it would leave such
parameters out without a word.
"""

from __future__ import annotations

import re
import tempfile
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from stack_counter.ros.processes import NODES

_BARE_NAME = re.compile(rf"""^(["']?)({'|'.join(NODES)})\1(\s*:)""", re.MULTILINE)


def with_any_namespace(text: str) -> str:
    """The text of a parameter file whose bare names stand for the node in any namespace."""
    return _BARE_NAME.sub(r'"/**/\2"\3', text)


@contextmanager
def fully_named(arguments: Sequence[str]) -> Iterator[list[str]]:
    """Gives arguments whose parameter files name nodes so that ROS 2 finds them.

    Args:
        arguments: of the command line; files that name nodes in full stay as they are.
    """
    given = list(arguments)
    with tempfile.TemporaryDirectory(prefix="stack_counter_") as folder:
        for place, option in enumerate(given[:-1]):
            path = Path(given[place + 1])
            if option != "--params-file" or not path.is_file():
                continue
            text = path.read_text(errors="replace")
            if (renamed := with_any_namespace(text)) != text:
                copy = Path(folder) / f"{place}.yaml"
                copy.write_text(renamed)
                given[place + 1] = str(copy)
        yield given
