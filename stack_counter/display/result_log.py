# SPDX-License-Identifier: Apache-2.0
"""A file that grows by one line for each result: CSV, or JSON lines."""

from __future__ import annotations

import csv
import errno
import io
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from stack_counter.display.result_schema import flat_line


@dataclass(frozen=True)
class ResultLogSettings:
    """How a log is kept small.

    Attributes:
        older_files: files beside the one that is written, each as large as that. Chosen.
    """

    older_files: int = 9


SETTINGS = ResultLogSettings()


class ResultLog:
    """Appends lines to a file, which is put aside when it is full.

    `results.csv` then becomes `results.1.csv`, that `results.2.csv`, and the oldest is deleted. A
    file that ends within a line or has another header is put aside as well.
    """

    def __init__(self, path: Path, max_mb: float):
        """Writes nothing yet.

        Args:
            path: ends in .csv, or else JSON lines are written; its folder is made.
            max_mb: size of all its files together, MB.
        """
        self._path = path
        self._max_bytes = max_mb * 1e6 / (1 + SETTINGS.older_files)  # of one file
        self._is_csv = path.suffix == ".csv"
        self._header = _csv_line(flat_line({})) if self._is_csv else b""

    def append(self, line: Mapping[str, Any]) -> None:
        """Appends the whole line, or nothing.

        Args:
            line: a result, as `log_line` of the schema has it.

        Raises:
            OSError: it cannot be written.
        """
        data = _csv_line(flat_line(line).values()) if self._is_csv \
            else f"{json.dumps(line)}\n".encode()
        self._path.parent.mkdir(parents=True, exist_ok=True)
        if not self._can_continue(len(data)):
            self._put_aside()
        with open(self._path, "ab", buffering=0) as file:
            start, written = file.tell(), 0
            data = data if start else self._header + data
            try:
                written = file.write(data)
            finally:
                if written < len(data):
                    file.truncate(start)
        if written < len(data):
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), str(self._path))

    def _can_continue(self, length: int) -> bool:
        """Whether so many bytes may be appended to the file as it is."""
        if not self._path.exists() or not self._path.stat().st_size:
            return True
        with open(self._path, "rb") as file:
            known = file.readline() == self._header if self._header else True
            file.seek(-1, os.SEEK_END)
            return known and file.read() == b"\n" and file.tell() + length <= self._max_bytes

    def _put_aside(self) -> None:
        """Renames the file and those before it; the oldest is overwritten."""
        names = [self._path, *(self._path.with_suffix(f".{number}{self._path.suffix}")
                               for number in range(1, SETTINGS.older_files + 1))]
        for newer, older in reversed(list(zip(names, names[1:]))):
            if newer.exists():
                newer.replace(older)


def _csv_line(cells: Any) -> bytes:
    """Returns one line of a CSV file."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerow(cells)
    return buffer.getvalue().encode()
