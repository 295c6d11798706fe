# SPDX-License-Identifier: Apache-2.0
"""Volumes and their counts are brought together, whichever comes first."""

import pytest
from stack_counter_msgs.msg import StackCount, StackVolume

from stack_counter.ros.heard_counts import HeardCounts
from stack_counter.ros.node_replay import _collect_cycles, _collect_scan
from stack_counter.ros.standard_messages import to_header


def pair(scan_id, stamp_s=1, number=5, final=True, error="", region=""):
    """A volume and its count."""
    shared = {"header": to_header(stamp_s * 10**9, "base_link"), "scan_id": scan_id,
              "final": final, "error": error, "region": region}
    return StackVolume(stack_volume=1e-3, **shared), StackCount(
        count=number, count_low=number, count_high=number, **shared)


def hear(pairs, heard=None, counts_first=False):
    heard = heard or HeardCounts([""])
    for volume, count in pairs:
        calls = [lambda v=volume: heard.add_volume(v), lambda c=count: heard.add_count(c)]
        for call in reversed(calls) if counts_first else calls:
            call()
    return heard


@pytest.mark.parametrize("counts_first", [False, True])
def test_the_last_number_stays_when_a_later_cycle_fails(counts_first):
    heard = hear([pair("cycle_1000", 1, 5), pair("cycle_2000", 2, error="too few"),
                  pair("cycle_3000", 3, 7), pair("cycle_4000", 4, error="dark")],
                 counts_first=counts_first)
    assert heard.is_settled and heard.has_ended("cycle_4000")
    got = _collect_cycles(heard, "")
    assert got.count.count == 7 and got.count.volume.stamp_ns == 3 * 10**9 and not got.error
    assert [entry["count"] for entry in got.counts] == [5, None, 7, None]
    assert got.counts[3] == {"stamp_ns": 4000, "count": None, "count_interval": None,
                             "error": "dark"}


def test_running_counts_are_no_cycles():
    heard = hear([pair("cycle_1000", 1, 4, final=False), pair("cycle_1000", 1, 5)])
    assert [entry["count"] for entry in _collect_cycles(heard, "").counts] == [5]


def test_a_live_scan_lists_its_own_counts_though_the_last_comes_after_the_final_one():
    (volume, late), (_, final) = pair("a", 2, 6, final=False), pair("a", 2, 7)
    heard = hear([pair("before", 1, error="0 views used"), pair("a", 1, 3, final=False)])
    heard.add_volume(volume)
    hear([pair("a", 2, 7)], heard)
    assert heard.has_ended("a") and not heard.is_settled
    heard.add_count(late)
    assert heard.is_settled
    got = _collect_scan(heard, "", "a", live=True)
    assert [entry["count"] for entry in got.counts] == [3, final.count]
    assert got.count.count == 7 and _collect_scan(heard, "", "a", live=False).counts == []


def test_a_scan_has_ended_when_every_region_has():
    heard = HeardCounts(["left", "right"])
    hear([pair("a", region="left")], heard)
    assert not heard.has_ended("a")
    hear([pair("a", region="right", error="nothing there")], heard)
    assert heard.has_ended("a")
    assert _collect_scan(heard, "right", "a", live=False).error.startswith("nothing there; 0 ima")


def test_cycles_of_which_none_counts_say_why_with_all_their_images():
    pairs = [pair(f"cycle_{k}000000000", k, error="too few") for k in (1, 2)]
    for _, count in pairs:
        count.views.received, count.views.skip_reasons = 4, ["no_tf"]
        count.views.skip_counts = [3]
    got = _collect_cycles(hear(pairs), "")
    assert got.count is None and got.error == (
        "cycle at 1.000 s: too few; none of 2 cycles gives a count; 8 images in the bag, "
        "skipped {'no_tf': 6}; stack-counter doctor BAG says what to change")
