# SPDX-License-Identifier: Apache-2.0
"""All results of a folder as one table: Parquet and CSV."""

from __future__ import annotations

import csv
import importlib
import io
from collections.abc import Iterable
from datetime import datetime
from pathlib import Path
from typing import Any

from stack_counter.archive.outcome import Outcome
from stack_counter.display.result_schema import FLAT_FIELDS, Schema, flat_line
from stack_counter.errors import ConfigError
from stack_counter.files import write_atomically

PARQUET, CSV = "results.parquet", "results.csv"
# Columns beside those of `result_log`, before and behind these, by what they hold.
_BEFORE = {"bag": "string", "exit_code": "integer"}
_BEHIND = {"report": "string", "counted_at": "string", "version": "string", "settings": "string",
           "part_digest": "string", "digest": "string", "key": "string"}
_TIMES = ("stamp", "counted_at")  # which Parquet knows as such


def require_pyarrow() -> Any:
    """Returns the module `pyarrow`.

    Raises:
        ConfigError: it is not installed.
    """
    try:
        return importlib.import_module("pyarrow")
    except ModuleNotFoundError as error:
        if error.name != "pyarrow":
            raise
        raise ConfigError("recount takes the package pyarrow, which is not installed; expected "
                          "pip install 'stack_counter[archive]'") from error


def last_outcomes(outcomes: Iterable[Outcome]) -> list[Outcome]:
    """Outcomes without those that a later one of the same bag takes the place of.

    That is one of the same result, or any later one where the first may have been chance.
    """
    last: dict[str, dict[str, Outcome]] = {}
    for outcome in outcomes:
        of_bag = last.setdefault(outcome.bag, {})
        for key in [key for key, before in of_bag.items() if not before.is_final]:
            del of_bag[key]
        of_bag[outcome.key] = outcome
    return [outcome for of_bag in last.values() for outcome in of_bag.values()]


def table_rows(outcomes: Iterable[Outcome]) -> list[dict[str, Any]]:
    """Cells by column, a row for each result of each outcome."""
    rows = []
    for outcome in outcomes:
        for line in outcome.results:
            own = {**vars(outcome), "exit_code": line["exit_code"], "report": line.get("report")}
            rows.append({**{name: own.get(name) for name in _BEFORE}, **flat_line(line),
                         **{name: own.get(name) for name in _BEHIND}})
    return rows


def write_tables(folder: Path, outcomes: Iterable[Outcome]) -> None:
    """Writes results.parquet and results.csv, each in one step.

    Args:
        folder: is there.
        outcomes: in the order in which they came.

    Raises:
        ConfigError: pyarrow is not installed.
        OSError: a file cannot be written.
    """
    rows = table_rows(last_outcomes(outcomes))
    _write_parquet(folder / PARQUET, rows)
    text = io.StringIO()
    table = csv.DictWriter(text, list(_column_kinds()), lineterminator="\n")
    table.writeheader()
    table.writerows(rows)
    write_atomically(folder / CSV, text.getvalue())


def _write_parquet(path: Path, rows: list[dict[str, Any]]) -> None:
    pyarrow = require_pyarrow()
    kinds = {"string": pyarrow.string(), "integer": pyarrow.int64(), "number": pyarrow.float64(),
             "boolean": pyarrow.bool_()}
    types = {name: kinds[kind] for name, kind in _column_kinds().items()}
    types |= {name: pyarrow.timestamp("us", "UTC") for name in _TIMES}
    table = pyarrow.Table.from_pylist([{**row, **{name: _moment(row[name]) for name in _TIMES}}
                                       for row in rows], pyarrow.schema(types.items()))
    unfinished = path.with_suffix(".unfinished")
    importlib.import_module("pyarrow.parquet").write_table(table, unfinished)
    unfinished.replace(path)


def _column_kinds() -> dict[str, str]:
    """What each column holds: string, integer, number or boolean."""
    return {**_BEFORE, **{name: _kind(schema) for name, schema in FLAT_FIELDS.items()}, **_BEHIND}


def _kind(schema: Schema) -> str:
    """What a value of a schema is, apart from null."""
    kinds = schema.get("type", "integer" if "const" in schema else "string")
    return kinds if isinstance(kinds, str) else next(kind for kind in kinds if kind != "null")


def _moment(text: str | None) -> datetime | None:
    return datetime.fromisoformat(text.replace("Z", "+00:00")) if text else None
