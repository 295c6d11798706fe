# SPDX-License-Identifier: Apache-2.0
"""One recording in every form that recorders write is the same recording to us."""

import sqlite3
import struct
import tempfile
from collections import namedtuple
from pathlib import Path

import numpy as np
import pytest
from kits.bag_formats import (
    FORMATS,
    SQLITE,
    bare,
    bare_mcap,
    messages_of,
    packed,
    ros1,
    rosbag2,
    split,
)
from kits.recording_kit import (
    CAMERA_INFO,
    COLOR,
    DEPTH,
    FRAME,
    IMAGE,
    INFO,
    STORE,
    TF,
    records,
    scan,
    tf_record,
)
from kits.recording_kit import write as write_recording
from mcap.writer import IndexType
from rosbags.rosbag2 import CompressionMode

from stack_counter.bag.formats import opening
from stack_counter.bag.formats.recording_file import TopicDecoder, is_latched
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replay import measure_bag
from stack_counter.config import load_config
from stack_counter.errors import BagError
from stack_counter.files import config_path

TOPICS = {COLOR, DEPTH, INFO, "/tf", "/tf_static"}


@pytest.fixture(scope="module")
def messages(tmp_path_factory):
    """(log time ns, topic, type, CDR) of a small scan with a static transform."""
    made = [tf_record(5, np.eye(4), "lens", FRAME, "/tf_static"), *records(scan())]
    return messages_of(write_recording(tmp_path_factory.mktemp("made") / "bag", made))


def read(path):
    """What a reader gives of a bag: (log time ns, topic, CDR)."""
    return [(r.log_time_ns, r.topic, r.data) for r in BagReader(path).records(TOPICS)]


@pytest.mark.parametrize("name", FORMATS)
def test_every_form_gives_the_same_records(tmp_path, messages, name):
    path = FORMATS[name](tmp_path, messages)
    reader = BagReader(path)
    assert read(path) == [(t, topic, data) for t, topic, _, data in messages]
    counts = {topic: [m[1] for m in messages].count(topic) for topic in TOPICS}
    assert {topic: count for topic, (_, count) in reader.topics.items()} == counts
    assert reader.topics["/tf"][0] == TF and reader.topics[INFO][0] == CAMERA_INFO
    assert not reader.truncated and reader.start_ns == 5
    assert reader.duration_ns == messages[-1][0] - 5
    of_recorder = not name.startswith(("bare mcap", "empty", "no chunks"))
    assert reader.latched == ({"/tf_static"} if of_recorder else set())
    info, image, static = (next(r.decode() for r in reader.records({topic}))
                           for topic in (INFO, COLOR, "/tf_static"))
    assert list(info.k) == scan()[0].intrinsics.K.ravel().tolist()
    assert bytes(image.data) == scan()[0].color.tobytes() and image.header.frame_id == FRAME
    assert static.transforms[0].child_frame_id == "lens"


@pytest.mark.parametrize("name", ["sqlite3", "ros1", "mcap by message"])
def test_every_form_gives_the_same_volume(tmp_path, messages, name):
    config = load_config(config_path("stack_counter.yaml"))
    expected = measure_bag(rosbag2(tmp_path / "mcap", messages), config).stack_volume
    assert measure_bag(FORMATS[name](tmp_path, messages), config).stack_volume == expected > 0


# --- files that are cut, packed or of no use ---------------------------------------------------

def test_of_a_cut_database_what_precedes_the_cut_is_read(tmp_path, messages):
    path = bare(rosbag2(tmp_path / "bag", messages, SQLITE), ".db3", tmp_path / "a.db3")
    data, expected, last = Path(path).read_bytes(), read(path), 0
    for share in (0.3, 0.6, 0.9, 0.99):
        Path(path).write_bytes(data[:int(share * len(data))])
        reader, got = BagReader(path), read(path)
        assert reader.truncated and got == expected[:len(got)] and last <= len(got)
        assert len(got) > 0.8 * share * len(expected)
        assert sum(count for _, count in reader.topics.values()) == len(got)
        last = len(got)
    Path(path).write_bytes(data[:5000])
    with pytest.raises(BagError, match="no rosbag2 database, or cut short before its first"):
        BagReader(path)


def test_what_a_killed_recorder_left_in_the_log_is_read(tmp_path, messages):
    path = bare(rosbag2(tmp_path / "bag", messages[:-1], SQLITE), ".db3", tmp_path / "a.db3")
    database = sqlite3.connect(path)
    database.execute("PRAGMA journal_mode=WAL")
    t, _, _, data = messages[-1]
    database.execute("INSERT INTO messages(topic_id, timestamp, data) VALUES(1, ?, ?)", (t, data))
    database.commit()
    assert Path(f"{path}-wal").stat().st_size
    assert len(read(path)) == len(messages)
    database.close()


def test_a_cut_packed_file_gives_what_unpacks(tmp_path):
    chance = np.random.default_rng(0)
    noise = [(i, COLOR, IMAGE, chance.bytes(50_000)) for i in range(30)]
    whole = packed(bare_mcap(tmp_path / "a.mcap", noise, True, chunk_size=100_000),
                   tmp_path / "b.mcap.zstd")
    expected = read(whole)
    whole.write_bytes(whole.read_bytes()[:whole.stat().st_size * 2 // 3])
    got = read(whole)
    assert 14 < len(got) <= 20 and got == expected[:len(got)]
    assert BagReader(whole).truncated
    whole.write_bytes(whole.read_bytes()[:9])
    with pytest.raises(BagError, match="b.mcap.zstd is cut short: nothing of it"):
        BagReader(whole)


def test_temporary_files_are_removed(tmp_path, messages, monkeypatch):
    path = FORMATS["db3 by file"](tmp_path, messages)
    (tmp_path / "tmp").mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    reader = BagReader(path)
    assert list((tmp_path / "tmp").iterdir())
    del reader
    assert not list((tmp_path / "tmp").iterdir())
    # Neither is anything left by what cannot be opened.
    (tmp_path / "text").write_text("no bag")
    with pytest.raises(BagError, match="no recording: it begins with b'no bag'"):
        BagReader(packed(tmp_path / "text", tmp_path / "a.bag.zstd"))
    assert not list((tmp_path / "tmp").iterdir())


def test_room_that_is_missing_is_told(tmp_path, messages, monkeypatch):
    path = FORMATS["bare mcap.zstd"](tmp_path, messages)
    monkeypatch.setattr(opening.shutil, "disk_usage",
                        lambda _: namedtuple("usage", "free")(10_000))
    with pytest.raises(BagError, match="unpacks to .* GB; .* GB free: set TMPDIR"):
        BagReader(path)


@pytest.mark.parametrize("content, said", [
    (b"", "is empty: its recorder was ended"),
    (b"PK\3\4 an archive", "begins with b'PK.*expected an .mcap, .db3, .bag file, not encrypted"),
    (b"#ROSBAG V1.2\n", "version 102 is not supported; expected a bag of ROS 1, version 2.0"),
    (b"SQLite format 3\0" + bytes(5000), "no rosbag2 database")])
def test_what_is_no_recording_says_what_it_is(tmp_path, content, said):
    (tmp_path / "a.bag").write_bytes(content)
    with pytest.raises(BagError, match=said) as caught:
        BagReader(tmp_path / "a.bag")
    assert "\n" not in str(caught.value)


def test_bags_of_ros_1_without_index_or_encrypted_name_what_helps(tmp_path, messages):
    path = ros1(tmp_path / "a.bag", messages)
    data = path.read_bytes()
    place = data.index(b"index_pos=") + len(b"index_pos=")
    path.write_bytes(data[:place] + bytes(8) + data[place + 8:])
    with pytest.raises(BagError, match="not indexed.*`rosbag reindex`"):
        BagReader(path)
    path.write_bytes(data[:len(data) // 2])  # copied in part: its index is gone
    with pytest.raises(BagError, match="index.*`rosbag reindex`"):
        BagReader(path)
    header = b"".join(struct.pack("<I", len(f)) + f for f in (
        b"op=\3", b"index_pos=" + bytes(8), b"conn_count=" + bytes(4), b"chunk_count=" + bytes(4),
        b"encryptor=rosbag/AesCbcEncryptor"))
    path.write_bytes(b"#ROSBAG V2.0\n" + struct.pack("<I", len(header)) + header)
    with pytest.raises(BagError, match="encryption.*expected.*not encrypted"):
        BagReader(path)


@pytest.mark.parametrize("options", [
    {"use_statistics": False}, {"repeat_channels": False}, {"repeat_schemas": False},
    {"index_types": IndexType.NONE}, {"index_types": IndexType.CHUNK},
    {"index_types": IndexType.MESSAGE}], ids=str)
def test_recorders_may_leave_out_what_they_like_of_the_index(tmp_path, messages, options):
    path = bare_mcap(tmp_path / "a.mcap", messages, True, chunk_size=20_000, **options)
    reader = BagReader(path)
    assert read(path) == [(t, topic, data) for t, topic, _, data in messages]
    assert sum(count for _, count in reader.topics.values()) == len(messages)
    assert not reader.truncated
    path.write_bytes(path.read_bytes()[:-30])  # nothing is lost with the end of the index
    assert read(path) == [(t, topic, data) for t, topic, _, data in messages]
    assert BagReader(path).truncated


@pytest.mark.parametrize("profiles, latched", [
    ("- durability: transient_local\n", True), ("- durability: 1\n", True),
    ("- durability: volatile\n- durability: 2\n", False), ("", False), ("[", False),
    ("[1, 2]", False)])
def test_latched_topics_are_those_that_were(profiles, latched):
    assert is_latched(profiles) == latched


# --- types ------------------------------------------------------------------------------------

def test_transforms_of_old_ros_1_are_those_of_today(tmp_path):
    old = STORE.serialize_ros1(tf_record(5, np.eye(4))[3], TF)
    decoder = TopicDecoder("/tf", "tf/tfMessage", encoding="ros1")
    assert decoder.kind == TF
    # A header of ROS 1 begins with its number.
    record = decoder.record(5, bytes(old)[:4] + b"\7\0\0\0" + bytes(old)[4:])
    assert record.decode().transforms[0].child_frame_id == FRAME
    with pytest.raises(BagError, match="a message on /tf is no tf2_msgs/msg/TFMessage of ROS 1"):
        decoder.record(5, bytes(old)[:30])


def test_a_type_that_nothing_defines_is_listed_and_refused_where_it_is_read(tmp_path):
    path = bare_mcap(tmp_path / "a.mcap", [(1, "/odd", "our_msgs/msg/Odd", b"\0\1\0\0")])
    reader = BagReader(path)
    assert reader.topics == {"/odd": ("our_msgs/msg/Odd", 1)}
    record, = reader.records({"/odd"})
    with pytest.raises(BagError, match="/odd has type 'our_msgs/msg/Odd', which the recording"):
        record.decode()
    path = bare_mcap(tmp_path / "b.mcap", [(1, "/json", TF, b"{}")], encoding="json")
    with pytest.raises(BagError, match="/json is encoded as 'json'; expected cdr or ros1"):
        list(BagReader(path).records({"/json"}))


# --- folders ----------------------------------------------------------------------------------

def test_a_folder_is_one_recording(tmp_path, messages):
    folder = split(tmp_path / "bag", messages)
    bare_mcap(folder / "other.mcap", messages)
    with pytest.raises(BagError, match="holds 2 recordings and no metadata.yaml; expected one"):
        BagReader(folder)


def test_a_folder_may_be_named_by_its_metadata(tmp_path, messages):
    folder = rosbag2(tmp_path / "bag", messages)
    assert read(folder / "metadata.yaml") == read(folder)


def test_files_packed_or_unpacked_since_are_found(tmp_path, messages):
    expected = [(t, topic, data) for t, topic, _, data in messages]
    folder = rosbag2(tmp_path / "a", messages)
    packed(folder / "a.mcap", folder / "a.mcap.zstd")
    (folder / "a.mcap").unlink()
    assert read(folder) == expected
    folder = rosbag2(tmp_path / "b", messages, SQLITE, CompressionMode.FILE)
    name, = (p.name for p in folder.glob("*.zstd"))
    rosbag2(tmp_path / "c", messages, SQLITE)
    (tmp_path / "c" / "c.db3").rename(folder / name.removesuffix(".zstd"))
    (folder / name).unlink()
    assert read(folder) == expected
