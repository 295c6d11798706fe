# SPDX-License-Identifier: Apache-2.0
"""What the nodes log of a scan."""

from stack_counter.nodes.scan_lines import forgotten_line, opened_line, views_line
from stack_counter.nodes.scan_queue import QueuedScan, ScanQueue
from stack_counter.types import PartRequest, ViewTally


def test_an_opened_scan_names_its_part_and_the_cameras_it_lacks():
    assert opened_line(QueuedScan("a", PartRequest("nut", 2e-6))) == "scan 'a' opened: part 'nut'"
    assert opened_line(QueuedScan("a", PartRequest("", 2e-6))) == \
        "scan 'a' opened: unit volume 2 cm3"
    assert opened_line(QueuedScan("a", missing=("left", "top"))) == \
        "scan 'a' opened: the counter's part; no view of left, top"


def test_the_end_of_a_scan_says_what_became_of_its_views():
    assert views_line("a", ViewTally(12, 12)) == "scan 'a': 12 views used of 12"
    assert views_line("a", ViewTally(12, 9, {"no_tf": 2, "blurred": 1})) == \
        "scan 'a': 9 views used of 12; skipped: 2 no_tf, 1 blurred"


def test_a_reset_names_the_scans_that_are_lost_by_it():
    queue = ScanQueue()
    assert forgotten_line(queue) == ""
    queue.enqueue(QueuedScan("a"))
    assert forgotten_line(queue) == "scan 'a' lost: reset was called"
    queue.enqueue(QueuedScan("b"))
    assert forgotten_line(queue) == "scan 'a' and 1 more lost: reset was called"
