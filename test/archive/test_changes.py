# SPDX-License-Identifier: Apache-2.0
"""A change is a count outside the other's interval, or one that came or went."""

import pytest
from kits.outcomes import line, outcome

from stack_counter.archive.changes import find_changes


def changes(before, now):
    old, new = outcome("a", before), outcome("a", now, version="2.0")
    return find_changes([new], [old, new])


@pytest.mark.parametrize("before, now, size", [
    (line(100), line(106), 1.2),
    (line(100, 90, 110), line(106, 105, 107), 0.6),  # the new interval does not hold the old one
    (line(100), line(None), float("inf")),
    (line(None), line(100), float("inf")),
])
def test_what_is_a_change(before, now, size):
    (change,) = changes(before, now)
    assert change.size == pytest.approx(size)
    assert (change.before.version, change.outcome.version) == ("1.0", "2.0")


@pytest.mark.parametrize("before, now", [(line(100), line(105)), (line(None), line(None)),
                                         (line(0, 0, 0), line(0, 0, 0))])
def test_what_is_none(before, now):
    assert not changes(before, now)


def test_lost_counts_come_first_then_the_largest_changes():
    history = [outcome(bag, line(100)) for bag in "abcd"]
    now = [outcome("a", line(110), version="2.0"), outcome("b", line(130), version="2.0"),
           outcome("c", line(None), version="2.0"), outcome("d", line(101), version="2.0")]
    assert [change.outcome.bag[-1] for change in find_changes(now, history + now)] \
        == ["c", "b", "a"]


def test_the_last_result_before_is_what_is_compared():
    history = [outcome("a", line(100)), outcome("a", line(200), version="1.5")]
    now = outcome("a", line(201), version="2.0")
    assert not find_changes([now], [*history, now])


@pytest.mark.parametrize("other", [{"digest": "another recording"},
                                   {"part": ("nut", 0.0, [0.0, 0.0, 0.0])},
                                   {"exit_code": 2}, {"bag": "/elsewhere/a"}])
def test_other_recordings_parts_and_chance_are_not_compared(other):
    now = outcome("a", line(200), version="2.0")
    assert not find_changes([now], [outcome("a", line(100), **other), now])


def test_regions_are_compared_each_with_itself():
    before = outcome("a", line(10, region="left"), line(50, region="right"))
    now = outcome("a", line(50, region="right"), line(30, region="left"), version="2.0")
    (change,) = find_changes([now], [before, now])
    assert change.line["region"] == "left" == change.line_before["region"]
