# SPDX-License-Identifier: Apache-2.0
"""Levels, rates and values of the diagnostics."""

import pytest
from std_msgs.msg import Header

from stack_counter.ros.diagnostics import OK, WARN, Rate, memory_mb, summarize, to_array


def test_the_worst_level_speaks_for_all():
    assert summarize([]) == (OK, "ok")
    assert summarize([(OK, "12 parts")]) == (OK, "12 parts")
    assert summarize([(OK, "12 parts"), (WARN, "no views"), (WARN, "late")]) == (
        WARN, "no views; late")


def test_rate_over_the_last_seconds(monkeypatch):
    now = [100.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    rate = Rate()
    assert (rate.hz, rate.count, rate.silent_s) == (0.0, 0, float("inf"))
    for _ in range(10):
        now[0] += 0.5
        rate.tick(latency_s=0.2)
    assert (rate.hz, rate.count, rate.latency_s) == (pytest.approx(2.0), 10, 0.2)
    now[0] += 4.0
    assert rate.silent_s == 4.0 and rate.hz == pytest.approx(3 / 5)
    now[0] += 2.0
    assert rate.hz == 0.0 and rate.count == 10


def test_values_are_texts_of_few_digits():
    message = to_array("counter", WARN, "late", {"age s": 1.23456, "views": 12}, Header())
    status, = message.status
    assert (status.name, status.level, status.message) == ("stack_counter: counter", WARN, "late")
    assert {v.key: v.value for v in status.values} == {"age s": "1.23", "views": "12"}


def test_memory_is_that_of_a_process():
    assert 10 < memory_mb() < 100_000
