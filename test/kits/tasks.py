# SPDX-License-Identifier: Apache-2.0
"""Functions that tests have workers call."""

import os
import signal
from dataclasses import dataclass, field
from pathlib import Path


@dataclass
class Squares:
    """Squares numbers, and notes those that its worker has had before.

    Attributes:
        killed_once: number whose worker is killed the first time; the file notes that it was.
        note: that file.
        killed: number whose worker is always killed.
        wrong: number that is refused.
    """

    killed_once: int = -1
    note: Path = Path()
    killed: int = -1
    wrong: int = -1
    before: list = field(default_factory=list)

    def __call__(self, number):
        if number == self.killed or number == self.killed_once and not self.note.exists():
            if number == self.killed_once:
                self.note.touch()
            os.kill(os.getpid(), signal.SIGKILL)
        if number == self.wrong:
            raise ValueError(f"{number} is wrong")
        self.before.append(number)
        return number ** 2, os.environ.get("OMP_NUM_THREADS"), list(self.before)
