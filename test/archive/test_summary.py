# SPDX-License-Identifier: Apache-2.0
"""The summary: changes first, a drawing for each part, links to reports; names are text."""

import html
import re

import pytest
from kits.outcomes import line, outcome

from stack_counter.archive.count_chart import SETTINGS, draw_counts
from stack_counter.archive.summary import write_summary


def page(folder, outcomes, history=()):
    write_summary(folder, outcomes, [*history, *outcomes])
    return (folder / "summary.html").read_text()


def test_what_changed_comes_before_what_is_drawn_and_listed(tmp_path):
    before = [outcome("a", line(100)), outcome("b", line(100, day=2))]
    now = [outcome("a", line(150), version="2.0"), outcome("b", line(101, day=2), version="2.0")]
    text = page(tmp_path, now, before)
    changes = text[text.index("Changed by more"):text.index("<svg")]
    assert "<b>150</b>" in changes and "version 1.0 before" in changes and "101" not in changes
    assert text.index("<svg") < text.index('id="all"')
    assert "2 counts" in text and "over time" in text


def test_reports_are_linked_and_errors_say_why(tmp_path):
    text = page(tmp_path, [outcome("a", line(1, report="reports/a b/report.html")),
                           outcome("b", line(None))])
    assert '<a href="reports/a%20b/report.html">a</a>' in text
    assert "3 views; expected more" in text and "Without a count" in text
    assert "None: each count lies within" in text


def test_a_name_with_markup_is_text_and_nothing_is_fetched(tmp_path):
    text = page(tmp_path, [outcome("<script>x", line(1, part="<img src=x>"))])
    assert "<script" not in text and "<img" not in text
    assert "default-src 'none'" in html.unescape(text)
    assert not re.search(r'(src|href)="?http', text)


def test_nothing_counted_is_a_page_as_well(tmp_path):
    assert "0 counts" in page(tmp_path, []) and "<svg" not in page(tmp_path, [])


def test_a_drawing_by_time():
    lines = [line(10, day=1), line(20, day=3), line(40, 30, 50, day=2)]
    chart = draw_counts("bolt", lines, [False, False, True])
    assert chart.by_time and (chart.low, chart.high, chart.number) == (10, 40, 3)
    assert chart.y_ticks[0] == (SETTINGS.height, 0) and chart.y_ticks[-1][1] >= 50
    assert re.findall(r"M([\d.]+)", chart.counts) == ["0.0", f"{SETTINGS.width:.1f}"]
    assert re.findall(r"M([\d.]+)", chart.changed) == [f"{SETTINGS.width / 2:.1f}"]
    assert [text for _, text in chart.x_ticks] == ["2026-11-01", "2026-11-03"]


@pytest.mark.parametrize("stamp", ["1970-01-01T00:00:12.000000Z", "2026-11-01T00:00:00.000000Z"])
def test_without_dates_that_differ_the_order_is_drawn(stamp):
    chart = draw_counts("", [line(0, 0, 0, stamp=stamp), line(0, 0, 0, stamp=stamp)], [False] * 2)
    assert not chart.by_time and not chart.x_ticks
    assert chart.y_ticks == [(SETTINGS.height, 0), (0.0, 1)]
