# SPDX-License-Identifier: Apache-2.0
"""Volumes as whoever reaches the domain may send them: of ever more regions, or beyond us."""

from types import SimpleNamespace

from stack_counter_msgs.msg import StackVolume

from stack_counter.config.named_region import MOST_REGIONS
from stack_counter.nodes import counter
from stack_counter.nodes.counter import CounterNode
from stack_counter.types import PartRequest


def test_ever_more_regions_take_no_more_publishers():
    counted, lines = [], []
    node = SimpleNamespace(
        _text_places={f"r{i}": None for i in range(MOST_REGIONS)},
        get_logger=lambda: SimpleNamespace(error=lambda text, **_: lines.append(text)),
        _count_volume=counted.append)
    CounterNode._on_volume(node, StackVolume(region="one more"))
    assert not counted and "region 'one more' dropped" in lines[0] and "expected" in lines[0]


def test_an_exception_that_nobody_expected_is_the_scans_error(monkeypatch):
    def fail(message):
        raise IndexError("of ours")

    monkeypatch.setattr(counter, "from_stack_volume", fail)
    lines = []
    node = SimpleNamespace(
        get_logger=lambda: SimpleNamespace(error=lines.append),
        _action=SimpleNamespace(requested_part=lambda scan_id: PartRequest("", 1e-6)),
        _config=SimpleNamespace(part_catalogue=""))
    count = CounterNode._count_volume(node, StackVolume(scan_id="odd", final=True))
    assert count.scan_id == "odd" and "could not be counted: IndexError: of ours" in count.error
    assert "Traceback" in lines[0]
