# SPDX-License-Identifier: Apache-2.0
"""All outcomes that a folder of results has ever had: a file to which lines are only added.

A run may be killed at any moment: of a line that is not whole nothing is read.
"""

from __future__ import annotations

import fcntl
import os
from pathlib import Path

from stack_counter.archive.outcome import Outcome
from stack_counter.errors import ConfigError

FILE = "outcomes.jsonl"


class Journal:
    """The outcomes of a folder, read at the start and added to.

    Attributes:
        outcomes: all of them, in the order in which they came.
    """

    def __init__(self, folder: Path):
        """Reads what is there; the folder is made where it does not exist.

        Raises:
            ConfigError: another run writes to the folder, or a line is none of an outcome.
            OSError: the folder cannot be written.
        """
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / FILE
        self._file = open(path, "a+b", buffering=0)
        try:
            fcntl.flock(self._file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError as error:
            self._file.close()
            raise ConfigError(f"another run writes to {folder}; expected one at a time: wait for "
                              "it, or name another folder") from error
        text = path.read_bytes()
        whole = text.rfind(b"\n") + 1
        self._file.truncate(whole)  # a line that a killed run has not finished
        self.outcomes: list[Outcome] = []
        for number, line in enumerate(text[:whole].splitlines(), 1):
            try:
                self.outcomes.append(Outcome.from_json(line))
            except ValueError as error:
                self._file.close()
                raise ConfigError(f"{path}, line {number}, is no outcome ({error}); expected what "
                                  "recount has written: name another folder") from error

    def append(self, outcome: Outcome) -> None:
        """Adds an outcome, which is on the disk when this returns.

        Raises:
            OSError: it cannot be written.
        """
        self._file.write(f"{outcome.as_json()}\n".encode())
        os.fsync(self._file.fileno())
        self.outcomes.append(outcome)

    def close(self) -> None:
        """Lets another run write."""
        self._file.close()
