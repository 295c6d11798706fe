# SPDX-License-Identifier: Apache-2.0
"""Parts of recordings that unpack to more than a recorder writes, and lengths beyond the file."""

import struct
from dataclasses import replace

import lz4.frame
import pytest
import zstandard
from kits.memory import limited_memory
from mcap.writer import CompressionType, Writer

from stack_counter.bag.formats import decompression
from stack_counter.bag.formats.mcap_file import McapFile
from stack_counter.bag.formats.recording_file import TopicDecoder
from stack_counter.errors import BagError

PACK = {decompression.decompress_zstd: zstandard.compress,
        decompression.decompress_lz4: lz4.frame.compress}


@pytest.mark.parametrize("unpack", PACK)
def test_content_comes_back_and_a_bomb_does_not(unpack, monkeypatch):
    data = bytes(range(256)) * 5000
    assert b"".join(unpack(PACK[unpack](data))) == data
    monkeypatch.setattr(decompression, "SETTINGS",
                        replace(decompression.SETTINGS, most_bytes=1 << 20))
    bomb = PACK[unpack](b"\0" * (64 << 20))
    with limited_memory(), pytest.raises(BagError, match="more than 1 MB; expected"):
        for _ in unpack(bomb):
            pass


def test_a_message_that_is_a_bomb_is_refused(monkeypatch):
    monkeypatch.setattr(decompression, "SETTINGS",
                        replace(decompression.SETTINGS, most_bytes=1 << 20))
    decoder = TopicDecoder("/image", "sensor_msgs/msg/Image")
    bomb = zstandard.compress(b"\0" * (64 << 20))
    with limited_memory(), pytest.raises(BagError, match="expected a recorder's"):
        decoder.record(0, bomb)


def small_bag(path):
    """A bag of ten messages in one chunk."""
    with open(path, "wb") as file:
        writer = Writer(file, compression=CompressionType.NONE)
        writer.start("ros2", "test")
        schema = writer.register_schema("std_msgs/msg/String", "ros2msg", b"string data")
        channel = writer.register_channel("/t", "cdr", schema)
        for i in range(10):
            writer.add_message(channel, i, struct.pack("<I", i) * 9, 0)
        writer.finish()
    return path


@pytest.mark.parametrize("length", [2**40, 2**63, 2**64 - 1])
@pytest.mark.parametrize("finished", [True, False])
def test_a_chunk_that_states_a_length_beyond_the_file_is_read_as_far_as_it_goes(
        tmp_path, length, finished):
    path = small_bag(tmp_path / "a.mcap")
    data = bytearray(path.read_bytes())
    at = 8
    while data[at] != 6:  # the chunk's record
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    data[at + 1:at + 9] = struct.pack("<Q", length)
    if finished:  # the index states the same: behind four times of 8 bytes
        index = data.index(b"\x08", at + 9)
        while struct.unpack_from("<Q", data, index + 25)[0] != at:
            index = data.index(b"\x08", index + 1)
        data[index + 33:index + 41] = struct.pack("<Q", length)
    else:
        del data[-20:]
    path.write_bytes(data)
    with limited_memory():
        file = McapFile(path)
        assert len(list(file.records({"/t"}, 0, 2**63 - 1))) in (0, 10)
    assert file.truncated
