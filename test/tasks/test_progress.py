# SPDX-License-Identifier: Apache-2.0
"""How progress is told, on a terminal and without one."""

import re
import sys
import threading
import time

import pytest

from stack_counter.tasks import progress as module
from stack_counter.tasks.progress import ProgressSettings, progress, progress_bar

PATIENCE_S = 30.0


@pytest.fixture
def short_period(monkeypatch):
    monkeypatch.setattr(module, "SETTINGS", ProgressSettings(line_period_s=0.01))


def wait_for_line(capsys, pattern):
    """Waits until stderr has a line like this; returns all that came before it, and it."""
    text, end = "", time.monotonic() + PATIENCE_S
    while not re.search(pattern, text, re.MULTILINE):
        assert time.monotonic() < end, text
        threading.Event().wait(0.005)
        text += capsys.readouterr().err
    return text


def test_without_a_terminal_lines_say_how_far_it_is(short_period, capsys):
    """Also while a step takes long."""
    with progress_bar("simulate", "scenes", total=64, done=32) as advance:
        text = wait_for_line(capsys, r"^simulate: 32 of 64 scenes, 00:00 so far$")
        advance(16)
        text += wait_for_line(capsys, r"^simulate: 48 of 64 scenes, 00:00 so far, about \d\d:\d\d "
                                      r"to go$")
    assert "\r" not in text and "|" not in text


def test_a_number_of_steps_that_is_not_known_is_left_out(short_period, capsys):
    for _ in progress(iter("ab"), "teach", "views"):
        wait_for_line(capsys, r"^teach: \d views, 00:00 so far$")


def test_short_work_prints_nothing(capsys):
    assert list(progress("abc", "work", "letters")) == ["a", "b", "c"]
    assert capsys.readouterr() == ("", "")


def test_lines_end_with_the_work(short_period, capsys):
    with pytest.raises(ValueError, match="broken"):
        for _ in progress([1, 2], "work", "items"):
            raise ValueError("broken")
    capsys.readouterr()
    threading.Event().wait(0.1)
    assert capsys.readouterr().err == ""


def test_on_a_terminal_a_bar_is_drawn(monkeypatch, capsys):
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True)
    for _ in progress(range(3), "work", "items"):
        pass
    drawn = capsys.readouterr().err
    assert "work:   0%|" in drawn and "3/3" in drawn and "\r" in drawn
