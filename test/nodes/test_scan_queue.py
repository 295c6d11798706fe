# SPDX-License-Identifier: Apache-2.0
"""The collector's queue: order, room, what is given up."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

from stack_counter.nodes.scan_queue import QueuedScan, ScanQueue
from stack_counter.types import Intrinsics, View


def view(stamp):
    return View(stamp, Intrinsics(2, 2, 1.0, 1.0, 0.5, 0.5), np.eye(4))


def sent(outbox):
    out = []
    while (due := outbox.take_due_view()) is not None:
        out.append((due[0].scan_id, due[2].stamp_ns))
    return out


def test_a_few_views_are_on_their_way_at_a_time():
    outbox, scan = ScanQueue(), QueuedScan("a")
    outbox.enqueue(scan)
    for i in range(9):
        scan.add("", view(i))
    assert sent(outbox) == [("a", i) for i in range(4)]
    scan.processed = 3
    assert sent(outbox) == [("a", 4), ("a", 5), ("a", 6)] and scan.views == 9


def test_the_next_scan_waits_until_the_first_is_finished():
    outbox = ScanQueue()
    for name in "ab":
        scan = QueuedScan(name, closed=True)
        outbox.enqueue(scan)
        scan.add("", view(1))
    assert sent(outbox) == [("a", 1)]
    outbox.remove_finished("b")
    assert sent(outbox) == []
    outbox.remove_finished("a")
    assert sent(outbox) == [("b", 1)]


def test_an_open_scan_is_not_finished():
    outbox = ScanQueue()
    outbox.enqueue(QueuedScan("a"))
    outbox.remove_finished("a")
    assert outbox.first is not None


def test_who_follows_what_happens_gets_the_newest_of_each_camera():
    outbox, scan = ScanQueue(), QueuedScan("a", newest_only=True)
    outbox.enqueue(scan)
    for i in range(3):
        scan.add("left", view(i))
        scan.add("right", view(10 + i))
    assert scan.lost == {"superseded": 4}
    assert sent(outbox) == [("a", 2)]
    scan.processed = 1
    assert sent(outbox) == [("a", 12)]


def test_too_many_views_or_scans_are_counted_and_given_up():
    scan = QueuedScan("a")
    for i in range(65):
        scan.add("", view(i))
    assert scan.lost == {"overrun": 5} and scan.waiting[0][1].stamp_ns == 5
    outbox = ScanQueue()
    dropped = [d.scan_id for i in range(22) for d in outbox.enqueue(QueuedScan(str(i)))]
    assert dropped == ["1", "2"] and outbox.first.scan_id == "0"  # the one on its way stays
