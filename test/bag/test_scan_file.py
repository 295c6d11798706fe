# SPDX-License-Identifier: Apache-2.0
"""The file of one scan: what other tools read in it, and what is left of it when it is cut."""

import random

import numpy as np
import pytest
from kits.recorder_kit import FACTS, camera, noise, received, record, views_of
from kits.recording_kit import FRAME, IMAGE, INFO, scan, tf_record
from mcap.opcode import Opcode
from mcap.reader import make_reader
from mcap.records import Metadata, SummaryOffset
from mcap.stream_reader import StreamReader
from mcap_ros2.decoder import DecoderFactory
from rosbags.highlevel import AnyReader
from rosbags.interfaces import QosDurability

from stack_counter import geometry
from stack_counter.bag.camera_topics import fit_camera_to_bag
from stack_counter.bag.info import describe_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.recorder import Recorder
from stack_counter.bag.scan_file import Recording
from stack_counter.config import CollectorConfig, Config
from stack_counter.errors import BagError

BIG = 1000.0  # MB


def test_views_come_back_and_other_tools_read_the_file(tmp_path):
    said = []
    recorder = Recorder(tmp_path, BIG, said.append)
    hand_eye = geometry.pose(np.eye(3), np.array([0.01, 0.02, 0.03]))
    static = received(tf_record(0, hand_eye, "other", FRAME, "/tf_static"))
    record(recorder, [static, *camera()])
    recorder.close()
    path, = tmp_path.iterdir()
    views = views_of(path)
    assert len(views) == 6 and not BagReader(path).truncated and not said
    for a, b in zip(scan(), views):
        np.testing.assert_array_equal(a.color, b.color)
        np.testing.assert_allclose(a.T_world_camera, b.T_world_camera, atol=1e-12)
    with open(path, "rb") as file:  # the format's own library, by the index at the end
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        assert reader.get_summary().statistics.message_count == 18 + 18 + 1
        stamps = [(m.publish_time, d.header.stamp.sec) for _, c, m, d in
                  reader.iter_decoded_messages([INFO])]
    assert stamps == [(i * 10**9, i) for i in range(1, 7)]
    with AnyReader([path]) as reader:  # an independent one
        qos = {c.topic: c.ext.offered_qos_profiles for c in reader.connections}
    assert qos["/tf_static"][0].durability == QosDurability.TRANSIENT_LOCAL and qos["/tf"] == []
    assert BagReader(path).facts == {**FACTS, "ended": "stop_scan"}
    text = describe_bag(path, Config())[0]
    assert "recorded part: nut" in text and "6 usable of 6" in text and "problems" not in text


@pytest.mark.parametrize("messages", [camera(), []], ids=["a scan", "no message"])
def test_a_finished_file_passes_what_checkers_of_files_ask(tmp_path, messages):
    recorder = Recorder(tmp_path, BIG, print)
    record(recorder, messages)
    recorder.close()
    path, = tmp_path.iterdir()
    with open(path, "rb") as file:
        records = list(StreamReader(file, validate_crcs=True).records)
    kinds = {type(record).__name__ for record in records}
    # An offset of a group in the summary names a group that has records.
    groups = [Opcode(r.group_opcode).name for r in records if isinstance(r, SummaryOffset)]
    assert {group.title().replace("_", "") for group in groups} <= kinds
    names = [r.name for r in records if isinstance(r, Metadata)]
    assert names == ["stack_counter", "stack_counter_end"]  # each name once
    assert BagReader(path).facts == {**FACTS, "ended": "stop_scan"}


@pytest.mark.parametrize("text", ["[", "5", "[5]", '[["camera"]]', '[["camera", "late"]]',
                                  '[["camera", Infinity]]', "[" * 100_000])
def test_a_list_of_lost_views_that_is_none_is_refused(tmp_path, text):
    Recording(tmp_path, FACTS, 0).finish({"overrun": text})
    path, = tmp_path.iterdir()
    with pytest.raises(BagError, match="expected a list of cameras with stamps"):
        assert BagReader(path).overrun


def test_a_part_file_can_be_read_up_to_its_last_image_wherever_it_is_cut(tmp_path):
    recording, ends = Recording(tmp_path, FACTS, 0), []
    part, = tmp_path.iterdir()
    for i, message in enumerate(camera(), 1):
        recording.write(message._replace(received_ns=i))
        if message.kind == IMAGE:
            recording.flush()
            ends.append((part.stat().st_size, i))
    assert part.suffix == ".part" and len(views_of(part)) == 6  # as a kill would leave it
    recording.finish({"ended": "stop_scan"})
    path, = tmp_path.iterdir()
    data, cut = path.read_bytes(), tmp_path / "cut.mcap"
    path.unlink()
    chance = random.Random(1)
    for place in chance.sample(range(8, len(data)), 60) + [end for end, _ in ends]:
        cut.write_bytes(data[:place])
        reader = BagReader(cut)
        got = len(list(reader.records(set(reader.topics))))
        assert got >= max((i for end, i in ends if end <= place), default=0), place
        assert reader.truncated


@pytest.mark.parametrize("scan_id, name", [
    ("../../x", "-x"), ("/etc/passwd", "-etc-passwd"), ("", "scan"), ("..", "-"),
    ("bin 7\n\0", "bin-7-"), ("é" * 9, "-"), ("n" * 500, "n" * 40), ("a_B-9", "a_B-9")])
def test_no_scan_id_leaves_the_folder(tmp_path, scan_id, name):
    recorder = Recorder(tmp_path / "in" / "here", BIG, print)
    record(recorder, [noise(1)], scan_id)
    recorder.close()
    path, = [p for p in tmp_path.rglob("*") if p.is_file()]
    assert path.parent == tmp_path / "in" / "here"
    assert path.name[:5] == "scan_" and path.name[24:] == f"_{name}.mcap"
    assert BagReader(path).facts["scan_id"] == scan_id


def test_a_folder_of_many_scans_is_not_one_bag(tmp_path):
    recorder = Recorder(tmp_path, BIG, print)
    for scan_id in "ab":
        record(recorder, camera(), scan_id)
    recorder.close()
    with pytest.raises(BagError, match="recordings of 2 scans; expected one.*_b.mcap"):
        BagReader(tmp_path)


def test_a_replay_with_the_settings_of_a_cell_is_not_recorded(tmp_path):
    """It would push the cell's own recordings out."""
    record(recorder := Recorder(tmp_path, BIG, print), camera())
    recorder.close()
    path, = tmp_path.iterdir()
    cell = CollectorConfig(record_folder=str(tmp_path))
    assert fit_camera_to_bag(cell, BagReader(path).topics).record_folder == ""
