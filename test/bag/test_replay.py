# SPDX-License-Identifier: Apache-2.0
"""A bag is counted by one call, and its views are read in one way."""


import pytest
from kits.bags import bag, bin_views

from stack_counter.bag.replay import count_bag, measure_bag, read_scan
from stack_counter.config import load_config
from stack_counter.errors import PartError, ScanError
from stack_counter.files import config_path

CONFIG = load_config(config_path("stack_counter.yaml"))


def test_a_part_is_named_or_its_volume_given(tmp_path):
    path = bag(tmp_path)
    with pytest.raises(PartError, match="expected one of them"):
        count_bag(path)
    with pytest.raises(PartError, match="unknown part 'no_such'"):
        count_bag(str(path), part="no_such")
    with pytest.raises(FileNotFoundError, match="no bag"):
        count_bag(tmp_path / "none", unit_volume=1e-6)


def test_volume_and_views_of_a_bag(tmp_path):
    path = bag(tmp_path)
    assert measure_bag(path, CONFIG).stack_volume == pytest.approx(0.2 * 0.15 * 0.05, rel=0.1)
    assert [view.stamp_ns for view in read_scan(path, CONFIG)] == [i * 10**9 for i in range(1, 7)]
    few = bag(tmp_path, bin_views(count=2), "few")
    with pytest.raises(ScanError, match="2 views used of 2.*; 2 images in the bag, skipped {}"):
        measure_bag(few, CONFIG)
