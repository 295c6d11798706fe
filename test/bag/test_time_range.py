# SPDX-License-Identifier: Apache-2.0
"""A part of a recording knows what was said before it; of a long one parts stand for all."""

from dataclasses import replace

import numpy as np
import pytest
from kits.bag_formats import SQLITE, bare_mcap, messages_of, ros1, rosbag2
from kits.command import run
from kits.recording_kit import (
    COLOR,
    DEPTH,
    FRAME,
    INFO,
    camera_info,
    records,
    scan,
    tf_record,
    write,
)

from stack_counter import geometry
from stack_counter.bag import sampling
from stack_counter.bag.bag_views import read_views
from stack_counter.bag.camera_topics import fit_rig_to_bag
from stack_counter.bag.formats import mcap_file
from stack_counter.bag.info import describe_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replay import measure_bag, read_scan
from stack_counter.bag.sampling import sampled_parts
from stack_counter.bag.time_range import WHOLE_BAG, TimeRange
from stack_counter.config import CollectorConfig, Config, load_config
from stack_counter.errors import BagError, ConfigError, ScanError
from stack_counter.files import config_path
from stack_counter.teaching.teach_container import teach_container
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

SECOND = 10**9
TOPICS = {COLOR, DEPTH, INFO, "/tf", "/tf_static"}
# What makes a bag of messages, as a path in a folder.
FORMS = {"mcap": lambda f, m: bare_mcap(f / "a.mcap", m, True, chunk_size=1_000),
         "db3": lambda f, m: rosbag2(f / "a", m, SQLITE),
         "ros1": lambda f, m: ros1(f / "a.bag", m)}


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """Six views, 1 s apart from 1 s on; their camera hangs on a lens that was described once."""
    views = [replace(view, camera="lens") for view in scan()]
    said = [record for record in records(views) if record[1] != INFO]
    said += [tf_record(0, geometry.pose(np.eye(3), np.array([0, 0, 0.01])), FRAME, "lens",
                       "/tf_static"),
             (SECOND // 2, INFO, "sensor_msgs/msg/CameraInfo",
              camera_info(views[0].intrinsics, SECOND // 2, "lens"))]
    return messages_of(write(tmp_path_factory.mktemp("made") / "bag", said))


def views_of(reader):
    """The views that a reader's part gives; none may be skipped."""
    assembler = RigAssembler(fit_rig_to_bag(load_rig(CollectorConfig()), reader.topics),
                             live=False)
    views = [view for _, view in read_views(reader, assembler)]
    assert not assembler.tally.skipped
    return views


@pytest.mark.parametrize("form", FORMS)
def test_a_part_has_its_images_and_all_that_holds(tmp_path, messages, form):
    path = FORMS[form](tmp_path, messages)
    whole = views_of(BagReader(path))
    part = BagReader(path, TimeRange.of_seconds(2.5, 5.0))
    views = views_of(part)
    assert [view.stamp_ns for view in views] == [3 * SECOND, 4 * SECOND]
    for view, same in zip(views, whole[2:4]):
        np.testing.assert_array_equal(view.T_world_camera, same.T_world_camera)
        assert view.intrinsics == same.intrinsics
    # What holds from before comes first, as if it were said at the part's beginning.
    got = list(part.records(TOPICS, {COLOR}))
    assert {got[0].topic, got[1].topic} == {"/tf_static", INFO}
    assert [r.log_time_ns for r in got] == sorted(r.log_time_ns for r in got)
    assert got[0].log_time_ns == 2 * SECOND  # half a second before the first image
    assert sum(r.topic == "/tf_static" for r in got) == 1
    assert BagReader(path, TimeRange.of_seconds(None, 2.5)).part(WHOLE_BAG).duration_ns \
        == messages[-1][0] - messages[0][0]


def test_of_a_part_all_commands_take_its_images_alone(tmp_path, messages):
    config = load_config(config_path("stack_counter.yaml"))
    path = FORMS["mcap"](tmp_path, messages)
    part = TimeRange.of_seconds(1.5, None)
    assert measure_bag(path, config, time_range=part).views.received == 5
    assert len(read_scan(path, config, part)) == 5
    with pytest.raises(ScanError, match="2 views used of 2 .*; expected at least 3"):
        teach_container(path, config, time_range=TimeRange.of_seconds(4.5, None))


def test_ranges_that_there_are_not(tmp_path, messages, capsys):
    for start, end in ((-1, None), (3, 2), (float("nan"), None), (2, float("nan"))):
        with pytest.raises(ConfigError, match="expected 0 <= start < end, seconds after"):
            TimeRange.of_seconds(start, end)
    assert TimeRange.of_seconds(None, None) == WHOLE_BAG
    path = FORMS["mcap"](tmp_path, messages)
    with pytest.raises(BagError, match=r"lasts 6.020 s; expected more than 9 s"):
        BagReader(path, TimeRange.of_seconds(9, None))
    code, _, err = run(capsys, "replay", path, "--part", "demo_nut", "--start", 3, "--end", 2)
    assert code == 2 and "--start is 3, --end 2.0" in err
    code, out, _ = run(capsys, "info", path, "--start", 2.5)
    assert code == 0 and "views    4 usable of 4" in out


def test_all_chunks_at_one_time_are_not_held_at_once(tmp_path, messages, monkeypatch):
    """Chunks that overlap are read again rather than held."""
    doubled = [message for message in messages for _ in range(3)]
    path = bare_mcap(tmp_path / "a.mcap", doubled[::7] + doubled[1::7], True, chunk_size=1_000)
    expected = [(r.log_time_ns, r.data) for r in BagReader(path).records(TOPICS)]
    assert [t for t, _ in expected] == sorted(t for t, *_ in doubled[::7] + doubled[1::7])
    monkeypatch.setattr(mcap_file, "SETTINGS", mcap_file.McapFileSettings(cached_bytes=100_000))
    reader = BagReader(path)
    held = []
    for record, wanted in zip(reader.records(TOPICS), expected):
        assert (record.log_time_ns, record.data) == wanted
        held.append(reader._files[0]._cached_bytes)
    assert 0 < max(held) <= 100_000 + 80_000  # one chunk more, if that is all


# --- long recordings --------------------------------------------------------------------------

class LongBag:
    """Stands for a reader of a long recording, with an image every second."""

    def __init__(self, count, size, time_range=WHOLE_BAG, images_per_chunk=1):
        self.topics = {COLOR: ("sensor_msgs/msg/Image", count)}
        self.size, self.time_range = size, time_range
        self._times = np.arange(0, count, images_per_chunk) * SECOND

    def times_ns(self, topics):
        return self._times if topics == {COLOR} else np.empty(0, np.int64)


@pytest.mark.parametrize("chunk", [1, 4])
def test_parts_are_spread_over_the_images(chunk):
    parts = sampled_parts(LongBag(10_000, 10**9, images_per_chunk=chunk), {COLOR})
    assert len(parts) == 10 and parts[0].start_ns == 0
    assert all(part.end_ns - part.start_ns == 20 * SECOND for part in parts[:-1])
    assert 9_976 <= parts[-1].start_ns / SECOND <= 9_980 and parts[-1].end_ns is None
    np.testing.assert_allclose(np.diff([p.start_ns / SECOND for p in parts]), 1109, atol=5)
    # Images of 50 MB each: few of them.
    parts = sampled_parts(LongBag(10_000, 10_000 * 50e6, images_per_chunk=chunk), {COLOR})
    assert sum((p.end_ns or 10**13) - p.start_ns for p in parts) <= 40 * SECOND


def test_few_images_are_all_looked_at():
    assert sampled_parts(LongBag(200, 10**6), {COLOR}) == [WHOLE_BAG]
    part = TimeRange.of_seconds(300, 400)
    assert sampled_parts(LongBag(10_000, 10**6, part), {COLOR}) == [part]
    assert sampled_parts(LongBag(0, 0), {COLOR}) == [WHOLE_BAG]
    parts = sampled_parts(LongBag(10_000, 10**6, TimeRange.of_seconds(300, 2300)), {COLOR})
    assert parts[0].start_ns == 300 * SECOND and parts[-1].end_ns == 2300 * SECOND


@pytest.mark.parametrize("form", FORMS)
def test_info_says_how_much_it_looked_at(tmp_path, messages, monkeypatch, form):
    path = FORMS[form](tmp_path, messages)
    text = describe_bag(path, Config())[0]
    assert "6 usable of 6\n" in text and "6.020 s from 1970-01-01 00:00:00 UTC" in text
    monkeypatch.setattr(sampling, "SETTINGS", sampling.SamplingSettings(images=2, parts=2))
    text = describe_bag(path, Config())[0]
    assert "views    2 usable of 2 looked at, in 2 parts of the bag\n" in text
    assert "problems" not in text and "duration 5.0 s" in text
