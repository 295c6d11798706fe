# SPDX-License-Identifier: Apache-2.0
"""Every way in which a file of messages can be cut, mixed or damaged."""

import random
import struct

import numpy as np
import pytest
from kits.recording_kit import FRAME, TF, records, scan, tf_record, write
from mcap.writer import CompressionType, Writer

from stack_counter.bag.camera_topics import fit_camera_to_bag
from stack_counter.bag.formats.mcap_file import McapFile
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig
from stack_counter.errors import BagError

KINDS = [(CompressionType.NONE, False), (CompressionType.NONE, True),
         (CompressionType.ZSTD, True), (CompressionType.LZ4, True)]


def make(path, compression=CompressionType.ZSTD, chunked=True, count=40, log_time=lambda i: i,
         channels=1):
    """A file of numbered messages of 3 kB; returns its path."""
    payload = np.random.default_rng(0).integers(0, 50, 3000, np.uint8).tobytes()
    with open(path, "wb") as file:
        writer = Writer(file, compression=compression, use_chunking=chunked, chunk_size=20_000)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        ids = [writer.register_channel(f"/t{i}", "cdr", schema) for i in range(channels)]
        for i in range(count):
            writer.add_message(ids[i % channels], log_time(i), struct.pack("<I", i) + payload, 0)
        writer.finish()
    return path


def numbers(path):
    """The numbers of the messages that a reader gives, in its order; all must be whole."""
    got = list(BagReader(path).records({f"/t{i}" for i in range(9)}))
    assert all(len(record.data) == 3004 for record in got)
    return [struct.unpack_from("<I", record.data)[0] for record in got]


@pytest.mark.parametrize("compression, chunked", KINDS)
def test_cut_at_any_byte_all_whole_messages_are_read(tmp_path, compression, chunked):
    path = make(tmp_path / "whole.mcap", compression, chunked)
    data, cut = path.read_bytes(), tmp_path / "cut.mcap"
    assert numbers(path) == list(range(40)) and not BagReader(path).truncated
    chance, last = random.Random(3), 0
    places = sorted(chance.sample(range(8, len(data)), 60)) + [len(data) - 1]
    for place in places:
        cut.write_bytes(data[:place])
        reader = BagReader(cut)
        got = numbers(cut)
        assert got == list(range(len(got))) and last <= len(got) <= 40, place
        assert reader.truncated
        assert sum(count for _, count in reader.topics.values()) == len(got)
        if compression is CompressionType.NONE:  # then it is known which are whole
            assert len(got) == sum(end <= place for end in message_ends(data)), place
        last = len(got)
    assert last == 40  # a cut index costs no message


def message_ends(data):
    """Ends of the messages in an uncompressed file."""
    ends, at = [], 8
    while at + 9 <= len(data):
        opcode, length = struct.unpack_from("<BQ", data, at)
        if opcode == 6:  # a chunk: its records begin after head, name of compression and length
            at += 9 + 28 + 4 + struct.unpack_from("<I", data, at + 9 + 28)[0] + 8
            continue
        at += 9 + length
        if opcode == 5:
            ends.append(at)
    return ends


def test_a_cut_chunk_gives_its_first_messages(tmp_path):
    """Half of a chunk of seven messages is not lost, whatever compressed it."""
    for compression in (CompressionType.ZSTD, CompressionType.LZ4):
        path = tmp_path / "one.mcap"
        random_bytes = np.random.default_rng(1)
        with open(path, "wb") as file:
            writer = Writer(file, compression=compression, chunk_size=10**8)
            writer.start("ros2", "test")
            schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
            channel = writer.register_channel("/a", "cdr", schema)
            for i in range(20):
                writer.add_message(channel, i, random_bytes.bytes(200_000), 0)
            writer.finish()
        path.write_bytes(path.read_bytes()[:2_500_000])
        assert 8 <= len(list(BagReader(path).records({"/a"}))) <= 12


@pytest.mark.parametrize("compression, chunked", KINDS)
def test_log_time_order_across_chunks(tmp_path, compression, chunked):
    """Recorders write topics with delays: neighbouring chunks overlap in time."""
    path = make(tmp_path / "a.mcap", compression, chunked, log_time=lambda i: i ^ 8, channels=3)
    expected = sorted(range(40), key=lambda i: i ^ 8)
    assert numbers(path) == expected != list(range(40))
    path.write_bytes(path.read_bytes()[:-20])  # without an index, too
    assert numbers(path) == expected


def test_files_of_one_bag_are_merged_by_time(tmp_path):
    """The tenth file of a split recording sorts before the second by name."""
    for place, name in ((0, "bag_0"), (40, "bag_2"), (80, "bag_10")):
        make(tmp_path / f"{name}.mcap", log_time=lambda i, place=place: place + i)
    times = [record.log_time_ns for record in BagReader(tmp_path).records({"/t0"})]
    assert times == list(range(120))
    assert BagReader(tmp_path).topics == {"/t0": ("std_msgs/msg/String", 120)}


def test_numbers_of_types_hold_within_a_file_only(tmp_path):
    """Both files number their types from 1, in another order."""
    write(tmp_path / "a", [tf_record(1, np.eye(4))])
    write(tmp_path / "b", [r for r in records(scan(count=1), poses=False)]
          + [tf_record(2, np.eye(4))])
    (tmp_path / "both").mkdir()
    for number, name in enumerate("ab"):
        (tmp_path / name / f"{name}.mcap").rename(tmp_path / "both" / f"both_{number}.mcap")
    reader = BagReader(tmp_path / "both")
    decoded = [r.decode() for r in reader.records(set(reader.topics))]
    assert sum(hasattr(m, "transforms") and m.transforms[0].child_frame_id == FRAME
               for m in decoded) == 2 == reader.topics["/tf"][1]
    assert reader.topics["/tf"][0] == TF


def test_a_damaged_chunk_is_left_out_and_told(tmp_path):
    path = make(tmp_path / "a.mcap", CompressionType.NONE)
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)
    reader = BagReader(path)
    got = list(reader.records({"/t0"}))
    assert 30 <= len(got) < 40 and reader.truncated


def test_zeros_at_the_end_are_no_messages(tmp_path):
    """Space that a recorder set aside before the power went."""
    path = make(tmp_path / "a.mcap", CompressionType.NONE, False)
    data = path.read_bytes()
    path.write_bytes(data[:message_ends(data)[18]] + bytes(100_000))
    assert BagReader(path).truncated and numbers(path) == list(range(19))


@pytest.mark.parametrize("content", [b"", b"\x89MCAP", b"SQLite format 3\0" * 9, b"\0" * 100])
def test_what_is_no_mcap_says_what_it_is(tmp_path, content):
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(BagError, match="not an mcap file: it begins with .*expected"):
        McapFile(path)


def test_the_head_alone_is_an_empty_bag(tmp_path):
    path = tmp_path / "a.mcap"
    path.write_bytes(b"\x89MCAP0\r\n")
    reader = BagReader(path)
    assert reader.truncated and reader.topics == {}
    with pytest.raises(BagError, match="no topics"):
        fit_camera_to_bag(CollectorConfig(), reader.topics)


def test_an_unknown_compression_is_named(tmp_path):
    path = make(tmp_path / "a.mcap")
    path.write_bytes(path.read_bytes().replace(b"\x04\0\0\0zstd", b"\x04\0\0\0zzip"))
    with pytest.raises(BagError, match="'zzip'; expected zstd or lz4"):
        numbers(path)
