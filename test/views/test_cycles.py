# SPDX-License-Identifier: Apache-2.0
"""Cycles of a rig: whole ones, dead cameras, late views, a clock that goes back."""

import numpy as np
import pytest

from stack_counter.errors import ViewError
from stack_counter.types import Intrinsics, View
from stack_counter.views.cycles import CycleGrouper

MS = 1_000_000


def view(stamp_ms):
    return View(stamp_ms * MS, Intrinsics(2, 2, 1.0, 1.0, 0.5, 0.5), np.eye(4))


def former(live=False, timeout_s=0.5):
    return CycleGrouper(("a", "b", "c"), 0.02, timeout_s, live)


def test_a_cycle_is_over_when_all_cameras_have_spoken():
    f = former()
    assert f.add_view("b", view(1000)) == [] and f.add_view("a", view(1010)) == []
    over, = f.add_view("c", view(1020))
    assert set(over.views) == {"a", "b", "c"} and f.missing_cameras(over) == []
    assert f.close_all() == []


def test_views_that_mingle_are_sorted_by_stamp():
    f = former()
    assert f.add_view("a", view(1000)) == [] and f.add_view("a", view(1200)) == []
    assert f.add_view("b", view(1001)) == [] and f.add_view("b", view(1201)) == []
    first, = f.add_view("c", view(1002))
    second, = f.add_view("c", view(1202))
    assert first.stamp_ns == 1000 * MS and second.stamp_ns == 1200 * MS


def test_a_dead_camera_is_missing_after_the_timeout_in_a_recording():
    f = former()
    f.add_view("a", view(1000))
    f.add_view("b", view(1001))
    over, = f.add_view("a", view(2000))
    assert f.missing_cameras(over) == ["c"] and over.stamp_ns == 1000 * MS
    assert [f.missing_cameras(c) for c in f.close_all()] == [["b", "c"]]


def test_live_the_wall_clock_decides_and_not_how_far_another_camera_is():
    f = former(live=True, timeout_s=1e-9)
    f.add_view("a", view(1000))
    assert f.add_view("a", view(9000)) == []
    assert [c.stamp_ns for c in f.close_expired()] == [1000 * MS, 9000 * MS]
    assert former(live=True, timeout_s=100).close_expired() == []


def test_a_later_cycle_that_is_whole_ends_those_before_it():
    f = former(live=True)
    f.add_view("a", view(1000))
    f.add_view("a", view(2000))
    f.add_view("b", view(2001))
    first, second = f.add_view("c", view(2002))
    assert f.missing_cameras(first) == ["b", "c"] and f.missing_cameras(second) == []


def test_a_view_that_comes_too_late_is_refused():
    f = former(live=True, timeout_s=1e-9)
    f.add_view("a", view(1000))
    f.close_expired()
    with pytest.raises(ViewError, match="late"):
        f.add_view("b", view(1001))


def test_a_clock_that_goes_back_does_not_make_all_views_late():
    f = former()
    f.add_view("a", view(100_000))
    f.close_all()
    assert f.add_view("a", view(1000)) == []
    assert [c.stamp_ns for c in f.close_all()] == [1000 * MS]
