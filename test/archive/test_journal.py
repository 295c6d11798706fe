# SPDX-License-Identifier: Apache-2.0
"""The journal keeps what it was given, whatever ends its writer."""

import pytest
from kits.outcomes import line, outcome

from stack_counter.archive.journal import FILE, Journal
from stack_counter.errors import ConfigError

A, B = outcome("a", line(10)), outcome("b", line(None))


def written(folder, *outcomes):
    journal = Journal(folder / "out")
    for item in outcomes:
        journal.append(item)
    journal.close()
    return folder / "out" / FILE


def read(folder):
    journal = Journal(folder / "out")
    journal.close()
    return journal.outcomes


def test_what_was_added_is_read(tmp_path):
    written(tmp_path, A)
    written(tmp_path, B)
    assert read(tmp_path) == [A, B]


def test_of_a_line_that_was_cut_short_nothing_is_read_or_left(tmp_path):
    path = written(tmp_path, A, B)
    whole = path.read_bytes()
    for cut in range(whole.index(b"\n") + 1, len(whole), 40):
        path.write_bytes(whole[:cut])
        assert read(tmp_path) == [A]
        assert path.read_bytes() == f"{A.as_json()}\n".encode()
        path.write_bytes(whole)


@pytest.mark.parametrize("text", ["{}", "nonsense", "[1]", '{"bag": "x"}'])
def test_a_file_of_something_else_is_refused_and_left_alone(tmp_path, text):
    path = written(tmp_path, A)
    path.write_text(path.read_text() + f"{text}\n")
    before = path.read_bytes()
    with pytest.raises(ConfigError, match="outcomes.jsonl, line 2, is no outcome"):
        read(tmp_path)
    assert path.read_bytes() == before


def test_two_runs_do_not_write_at_once(tmp_path):
    journal = Journal(tmp_path)
    with pytest.raises(ConfigError, match="another run writes to .*; expected one at a time"):
        Journal(tmp_path)
    journal.close()
    Journal(tmp_path).close()
