# SPDX-License-Identifier: Apache-2.0
"""What the count of one bag has given: a result for each region, or an error."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import dataclass, field
from typing import Any

# Exit codes of what would be the same again: a count, and a recording that cannot give one. The
# others are the user's to mend, or chance: they are tried again.
_FINAL = (0, 3)


@dataclass(frozen=True)
class Outcome:
    """What the count of one bag has given.

    Attributes:
        bag: absolute path.
        state: sizes and times of change of its files; empty where they cannot be read.
        digest: of its content; empty where it could not be read.
        version: of the package.
        settings: digest of settings and weights.
        part: name, v (m3) and outer size (m) by which the part was looked up; empty if it was not.
        part_digest: of what was then known of it.
        key: names the result; empty where it never came to a count.
        exit_code: 0: there is a count; else as of `replay`, 1: a defect or a lost worker.
        counted_at: when, ISO 8601, UTC.
        results: lines as those of `result_log`, one for each region, or one with the error; each
            with its own `exit_code` and, where one was written, its `report`: path of the page
            from the folder of results on.
    """

    bag: str
    version: str
    settings: str
    counted_at: str
    state: str = ""
    digest: str = ""
    part: tuple[Any, ...] = ()
    part_digest: str = ""
    key: str = ""
    exit_code: int = 0
    results: tuple[dict[str, Any], ...] = field(default=())

    @property
    def is_final(self) -> bool:
        """Whether it would be the same again."""
        return self.exit_code in _FINAL

    def as_json(self) -> str:
        """Returns one line."""
        return json.dumps(dataclasses.asdict(self))

    @classmethod
    def from_json(cls, line: str | bytes) -> Outcome:
        """Reads a line.

        Raises:
            ValueError: it is no such line.
        """
        values = json.loads(line)
        try:
            values["part"], values["results"] = tuple(values["part"]), tuple(values["results"])
            return cls(**values)
        except (TypeError, KeyError) as error:
            raise ValueError(str(error)) from error
