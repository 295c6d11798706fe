# SPDX-License-Identifier: Apache-2.0
"""A bag is counted by one call, and its views are read in one way."""

from dataclasses import replace

import pytest
from kits.bags import bag, bin_views
from kits.recording_kit import COLOR, COMPRESSED, INFO, compressed, records, scan, write

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


def test_the_scale_of_a_bag_goes_into_volume_and_interval(tmp_path):
    sure, unsure = bag(tmp_path), bag(tmp_path, name="unsure", scale_std=0.05)
    volumes = [measure_bag(path, CONFIG) for path in (sure, unsure)]
    counts = [count_bag(path, unit_volume=1e-5, config=CONFIG) for path in (sure, unsure)]
    for before, after in (volumes, [count.volume for count in counts]):
        assert after.stack_volume == before.stack_volume
        assert after.stack_volume_std**2 - before.stack_volume_std**2 == pytest.approx(
            (0.15 * before.stack_volume)**2)
    assert counts[0].count == counts[1].count
    (low, high), (lower, higher) = (count.count_interval for count in counts)
    assert lower < low and high < higher


def by_both_transports(path):
    """A bag with six raw colour images, and the first four of them compressed."""
    said = records(scan())
    return write(path, said + [(view.stamp_ns, f"{COLOR}/compressed", COMPRESSED, compressed(
        view.color, stamp_ns=view.stamp_ns)) for view in scan()[:4]])


@pytest.mark.parametrize("transport, views", [("auto", 6), ("raw", 6), ("compressed", 4)])
def test_color_images_are_read_as_set_or_as_they_are_there(tmp_path, transport, views):
    path = by_both_transports(tmp_path / "both")

    def count(path, **settings):
        collector = replace(CONFIG.collector, color_transport=transport, **settings)
        return len(read_scan(path, replace(CONFIG, collector=collector)))

    assert count(path) == views
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"cameras: {{a: {{color_topic: {COLOR}, camera_info_topic: {INFO}}}}}\n")
    assert count(path, rig=str(rig)) == views
    only = write(tmp_path / "raw", records(scan()))
    assert count(only) == 6, "the only transport there is, whatever is set"


def test_each_camera_of_a_rig_finds_its_transport(tmp_path):
    """Two cameras, of which one is recorded compressed."""
    said = records(scan())
    said += [(view.stamp_ns, "/b/image/compressed", COMPRESSED,
              compressed(view.color, stamp_ns=view.stamp_ns)) for view in scan()]
    rig = tmp_path / "rig.yaml"
    rig.write_text(f"cameras:\n  a: {{color_topic: {COLOR}, camera_info_topic: {INFO}}}\n"
                   f"  b: {{color_topic: /b/image, camera_info_topic: {INFO}}}\n")
    config = replace(CONFIG, collector=replace(CONFIG.collector, rig=str(rig)))
    assert len(read_scan(write(tmp_path / "bag", said), config)) == 12
