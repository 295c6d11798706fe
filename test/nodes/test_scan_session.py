# SPDX-License-Identifier: Apache-2.0
"""Scans of the three modes, without ROS: what is sent when, what is lost, what is given up."""

from collections import Counter

import numpy as np
import pytest

from stack_counter.errors import ScanError
from stack_counter.nodes.scan_events import (
    Problem,
    ScanClosed,
    ScanOpened,
    ScanSent,
    ViewDropped,
    ViewReady,
    ViewsDecided,
)
from stack_counter.nodes.scan_modes import make_session
from stack_counter.nodes.scan_session import SETTINGS
from stack_counter.types import Intrinsics, PartRequest, View, ViewTally
from stack_counter.views.rig import Rig, RigCamera

CAMERAS = ("left", "right")


def view(stamp_s):
    return View(round(stamp_s * 1e9), Intrinsics(2, 2, 1.0, 1.0, 0.5, 0.5), np.eye(4))


class Source:
    """Gives the views that a test puts in; those with a reason are skipped instead."""

    def __init__(self):
        self.waiting, self.received, self.used = [], 0, 0
        self.skipped = Counter()

    def put(self, camera, stamp_s, reason=""):
        self.waiting.append((camera, view(stamp_s), reason))

    def start(self):
        self.__init__()

    def poll(self):
        decided, self.waiting = self.waiting, []
        accepted = [(camera, image) for camera, image, reason in decided if not reason]
        self.received, self.used = self.received + len(decided), self.used + len(accepted)
        self.skipped.update(reason for _, _, reason in decided if reason)
        return accepted

    flush = poll

    @property
    def tally(self):
        return ViewTally(self.received, self.used, dict(self.skipped))


class Clock:
    now = 100.0

    def __call__(self):
        return self.now


class Bench:
    """A session with a source and a clock of the test's own."""

    def __init__(self, mode, ready=True):
        rig = Rig(tuple(RigCamera(name, None, None) for name in CAMERAS), 0.01, 0.5)
        self.source, self.part = Source(), PartRequest("nut", 2e-6)
        self.session = make_session(mode, rig, self.source, lambda: self.part)
        self.clock = self.session._clock = Clock()
        self.session.reconstructor_ready = ready

    def give(self, *stamps, camera="left"):
        for stamp in stamps:
            self.source.put(camera, stamp)
        return self.session.collect_views()

    def report(self, scan_id, received=0, idle=False, stopped=False):
        return self.session.on_reconstructor_status(scan_id, received, idle, stopped)


def sent(events):
    return [(e.scan.scan_id, e.view.stamp_ns / 1e9) for e in events if isinstance(e, ViewReady)]


def of_kind(events, kind):
    return [event for event in events if isinstance(event, kind)]


def test_a_single_scan_opens_sends_four_at_a_time_and_is_announced():
    bench = Bench("scan")
    assert bench.session.start_by_itself() == [] and bench.give(1) == []
    opened = bench.session.start("bin7")
    assert [type(e) for e in opened] == [ScanOpened, ViewsDecided]
    assert opened[0].scan.part == bench.part
    assert sent(bench.give(1, 2, 3, 4, 5, 6)) == [("bin7", t) for t in (1, 2, 3, 4)]
    assert sent(bench.report("bin7", received=2)) == [("bin7", 5), ("bin7", 6)]
    stopped = bench.session.stop()
    assert [type(e) for e in stopped] == [ScanClosed, ScanSent]
    closed = bench.session.last_closed
    assert closed.views == 6 and closed.tally == ViewTally(6, 6, {})
    assert bench.report("bin7", received=6, stopped=True) == [] and len(bench.session.queue) == 0


def test_a_second_start_is_refused_while_a_scan_is_open_and_stop_without_one():
    bench = Bench("scan")
    with pytest.raises(ScanError, match="no scan is open; expected start_scan first"):
        bench.session.stop()
    bench.session.start("a")
    with pytest.raises(ScanError, match="scan 'a' is open; expected none"):
        bench.session.check_startable()
    bench.session.stop()
    bench.session.check_startable()
    with pytest.raises(ScanError, match="no scan is open"):
        bench.session.stop()


def test_skipped_images_are_told_of_and_belong_to_their_own_scan():
    bench = Bench("scan")
    bench.session.start("a")
    bench.source.put("left", 1, "no_tf")
    assert bench.session.collect_views() == [ViewsDecided(bench.session.scan)]
    assert bench.session.collect_views() == []
    bench.session.stop()
    assert bench.session.last_closed.tally == ViewTally(1, 0, {"no_tf": 1})
    bench.session.start("b")
    assert bench.session.tally == ViewTally()


def test_views_wait_for_a_reconstructor_that_is_not_there_yet():
    bench = Bench("scan", ready=False)
    bench.session.start("a")
    assert sent(bench.give(1, 2)) == []
    assert bench.session.problems() == ["2 views wait for a reconstructor"]
    assert sent(bench.report("", idle=True)) == [("a", 1), ("a", 2)]
    assert bench.session.problems() == []


def test_the_end_is_announced_again_until_the_reconstructor_answers():
    bench = Bench("scan")
    bench.session.start("a")
    bench.give(1)
    assert of_kind(bench.session.stop(), ScanSent)
    bench.clock.now += 1.9
    assert bench.session.on_timer(message_since_tick=False) == []
    bench.clock.now += 0.2
    assert of_kind(bench.session.on_timer(message_since_tick=False), ScanSent)
    bench.report("a", received=1, stopped=True)
    bench.clock.now += 9
    assert bench.session.on_timer(message_since_tick=False) == []


def test_what_a_reconstructor_that_started_anew_has_lost_is_counted():
    bench = Bench("scan")
    bench.session.start("a")
    bench.give(1, 2, 3, 4, 5)
    for _ in range(SETTINGS.lost_after_ticks):
        assert bench.report("", idle=True) == [] == bench.session.on_timer(False)
    bench.report("", idle=True)
    events = bench.session.on_timer(False)
    assert "scan 'a': the reconstructor has none of its views" in of_kind(events, Problem)[0].text
    assert sent(events) == [("a", 5)] and bench.session.scan.lost == {"views_lost": 4}


def test_views_are_not_lost_because_a_node_stood_still():
    bench = Bench("scan")
    bench.session.start("a")
    bench.give(1)
    bench.report("", idle=True)
    bench.clock.now += 60  # the reconstructor reports again, then takes the view from its queue
    bench.report("", idle=True)
    assert of_kind(bench.session.on_timer(False), Problem) == []
    bench.report("a", received=1)
    bench.clock.now += 60  # we stood still, and all its reports come at once
    for _ in range(300):
        bench.report("", idle=True)
    assert of_kind(bench.session.on_timer(False), Problem) == []
    assert not bench.session.scan.lost


def test_too_many_views_that_wait_are_dropped_oldest_first():
    bench = Bench("scan", ready=False)
    bench.session.start("a")
    events = bench.give(*range(1, 63))
    assert [e.view.stamp_ns for e in of_kind(events, ViewDropped)] == [10**9, 2 * 10**9]


def test_the_continuous_mode_goes_on_after_start_and_stop():
    bench = Bench("continuous")
    first = of_kind(bench.session.start_by_itself(), ScanOpened)[0].scan
    assert bench.session.start_by_itself() == []
    assert sent(bench.give(1, 2, 3)) == [(first.scan_id, 3)]  # the newest alone
    events = bench.session.start("named")
    assert [type(e) for e in events] == [ScanClosed, ScanSent, ScanOpened, ViewsDecided]
    assert bench.session.open_scan_id == "named"
    bench.session.stop()
    assert bench.session.last_closed.scan_id == "named"
    assert bench.session.accepting_images and bench.session.open_scan_id != "named"


def test_a_cycle_is_a_scan_once_all_cameras_gave_a_view():
    bench = Bench("cycle")
    assert [type(e) for e in bench.session.start_by_itself()] == [ScanOpened, ViewsDecided]
    assert sent(bench.give(1)) == []
    events = bench.give(1.004, camera="right")
    assert [type(e) for e in events] == [ScanClosed, ViewReady, ViewReady, ScanSent, ScanOpened,
                                         ViewsDecided]
    closed = bench.session.last_closed
    assert (closed.scan_id, closed.missing, closed.views) == ("cycle_1000000000", (), 2)
    assert closed.tally == ViewTally(2, 2, {}) and bench.session.open_scan_id == ""


def test_progress_between_two_cycles_names_neither():
    """The id of the one before would say that it begins anew; its end, repeated, then ends it."""
    bench = Bench("cycle")
    bench.session.start_by_itself()
    bench.give(1)
    assert bench.give(1.004, camera="right")[-1] == ViewsDecided(None)
    assert bench.give(2)[-1] == ViewsDecided(None)


def test_a_camera_that_gives_nothing_is_named_when_the_wait_is_over(monkeypatch):
    bench = Bench("cycle")
    bench.session.start_by_itself()
    bench.give(1)
    now = [1e6]
    monkeypatch.setattr("stack_counter.views.cycles.awake_time", lambda: now[0])
    assert bench.session.on_timer(message_since_tick=True) == []  # our own queue is what is late
    bench.clock.now += 6  # the node stood still: images of that time are not handled yet
    assert bench.session.on_timer(message_since_tick=False) == []
    bench.clock.now += 0.1
    assert of_kind(bench.session.on_timer(message_since_tick=False), ScanClosed)
    assert bench.session.last_closed.missing == ("right",)
    late = bench.give(1.002, camera="right")
    assert of_kind(late, Problem)[0].repeated and bench.session.tally.skipped == {"late_right": 1}


def test_stop_closes_the_cycle_that_waits_and_goes_on():
    bench = Bench("cycle")
    bench.session.start_by_itself()
    with pytest.raises(ScanError, match="no image has come since the start; expected a cycle"):
        bench.session.stop()
    bench.give(1)
    assert of_kind(bench.session.stop(), ScanClosed)
    assert bench.session.accepting_images and bench.session.last_closed.missing == ("right",)


def test_a_reconstructor_that_is_too_slow_for_the_cycles_loses_the_oldest_that_wait():
    bench = Bench("cycle")
    bench.session.start_by_itself()
    events = []
    for i in range(1, 23):
        events += bench.give(i) + bench.give(i, camera="right")
    assert [e.text.split("'")[1] for e in of_kind(events, Problem)] == [
        "cycle_2000000000", "cycle_3000000000"]
    assert bench.session.problems()[-1] == "20 scans wait: the cycles are too fast"
