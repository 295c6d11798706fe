# SPDX-License-Identifier: Apache-2.0
"""How an answer to a hard scan is judged, and the table of it."""

from types import SimpleNamespace

import pytest

from stack_counter.cli import main
from stack_counter.eval.robustness import Outcome, format_table, judge


@pytest.mark.parametrize("interval, status, true, want", [
    ((90, 110), "ok", 100, "right"),
    ((90, 110), "degraded", 100, "right"),
    ((90, 99), "ok", 100, "wrong"),
    ((90, 99), "degraded", 100, "honest"),
    ((10, 900), "ok", 100, "vague"),
    ((10, 900), "degraded", 100, "honest"),
    ((0, 0), "ok", 0, "right"),
    ((0, 7), "ok", 0, "vague"),
    ((1, 6), "ok", 2, "right"),
])
def test_an_answer_is_judged_by_its_interval_and_its_status(interval, status, true, want):
    assert judge(SimpleNamespace(count_interval=interval, status=status), true) == want


def test_the_table_counts_each_outcome_by_kind():
    made = [Outcome(0, kind, "", 1, outcome, 1, 1, 1, "ok", "") for kind, outcome in (
        ("raised", "right"), ("raised", "wrong"), ("no bin", "honest"), ("no bin", "right"))]
    lines = {line[:17].strip(): line[17:].split() for line in format_table(made).splitlines()}
    assert lines["raised"] == ["2", "1", "0", "0", "1", "50.0%"]
    assert lines["no bin"] == ["2", "1", "1", "0", "0", "0.0%"]
    assert lines["all"] == ["4", "2", "1", "0", "1", "25.0%"]


def test_an_unknown_kind_is_named_with_those_there_are(capsys):
    assert main(["evaluate", "robustness", "--kind", "raise"]) == 2
    error = capsys.readouterr().err
    assert "--kind raise" in error and "raised" in error
