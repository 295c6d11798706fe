# SPDX-License-Identifier: Apache-2.0
"""Tables have a row for every result, and one schema whatever is in them."""

import csv
import sys
from datetime import UTC, datetime

import pytest
from kits.outcomes import line, outcome

from stack_counter.archive.tables import last_outcomes, require_pyarrow, write_tables
from stack_counter.errors import ConfigError

parquet = pytest.importorskip("pyarrow.parquet", reason="no pyarrow: pip install "
                                                        "'stack_counter[archive]'")


def tables(folder, outcomes):
    write_tables(folder, outcomes)
    with open(folder / "results.csv", newline="") as file:
        return list(csv.DictReader(file)), parquet.read_table(folder / "results.parquet")


def test_a_row_for_each_region_and_error(tmp_path):
    rows, table = tables(tmp_path, [outcome("a", line(7, region="l", report="reports/x.html"),
                                            line(None, region="r")), outcome("b", line(None))])
    assert [(row["bag"], row["region"], row["count"], row["exit_code"]) for row in rows] == [
        ("/cell/a", "l", "7", "0"), ("/cell/a", "r", "", "3"), ("/cell/b", "", "", "3")]
    assert rows[0]["report"] == "reports/x.html" and rows[2]["error"] == "3 views; expected more"
    assert table.column("count").to_pylist() == [7, None, None]
    assert table.column("stamp").to_pylist()[0] == datetime(2026, 11, 1, 8, tzinfo=UTC)
    assert table.column_names == list(rows[0])


def test_the_schema_does_not_depend_on_the_rows(tmp_path):
    _, none = tables(tmp_path, [])
    _, error = tables(tmp_path, [outcome("b", line(None))])
    _, some = tables(tmp_path, [outcome("a", line(7))])
    assert none.schema == error.schema == some.schema


def test_columns_have_the_types_of_their_values(tmp_path):
    _, table = tables(tmp_path, [])
    types = {name: str(table.schema.field(name).type) for name in table.column_names}
    assert {name: types[name] for name in ("count", "gamma", "views.used", "fill_level.1",
                                           "reasons", "overfilled", "net_weight_kg", "stamp")} == {
        "count": "int64", "gamma": "double", "views.used": "int64", "fill_level.1": "double",
        "reasons": "string", "overfilled": "bool", "net_weight_kg": "double",
        "stamp": "timestamp[us, tz=UTC]"}


def test_a_later_outcome_takes_the_place_of_chance_and_of_the_same_result():
    lost = outcome("a", line(None, exit_code=1), key="", exit_code=1)
    first, again = outcome("a", line(7)), outcome("a", line(7, report="x"))
    newer = outcome("a", line(8), version="2.0")
    assert last_outcomes([lost, first, again, newer]) == [again, newer]
    assert last_outcomes([first, lost]) == [first, lost]


def test_without_pyarrow_one_line_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(ConfigError, match=r"pyarrow, which is not installed; expected pip install "
                                          r"'stack_counter\[archive\]'$"):
        require_pyarrow()
