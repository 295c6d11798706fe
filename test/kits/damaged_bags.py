# SPDX-License-Identifier: Apache-2.0
"""A recording damaged in every way that recorders, disks and clocks know."""

import random
from dataclasses import replace

from kits.bag_formats import SQLITE, bare, bare_mcap, messages_of, packed, ros1, rosbag2
from kits.recording_kit import COLOR, DEPTH, INFO, make, records, scan, write
from mcap.writer import IndexType

WRAP_NS = 2**32 * 1000  # a clock of 32 bits that counts microseconds begins again


def said():
    """What the camera and the arm of a healthy recording say."""
    return records(scan())


def healthy(folder):
    """The healthy recording, an .mcap file."""
    return bare_mcap(folder / "a.mcap", messages_of(write(folder / "made", said())), True,
                     chunk_size=100_000)


def cut(share, make_file=healthy):
    """What makes the recording of which a share is there."""
    def damage(folder):
        path = make_file(folder)
        path.write_bytes(path.read_bytes()[:int(share * path.stat().st_size)])
        return path
    return damage


def flipped(seed, bits=8):
    """What makes the recording with some bits flipped, anywhere."""
    def damage(folder):
        path, chance = healthy(folder), random.Random(seed)
        data = bytearray(path.read_bytes())
        for _ in range(bits):
            data[chance.randrange(8, len(data))] ^= 1 << chance.randrange(8)
        path.write_bytes(data)
        return path
    return damage


def restamped(new_stamp_ns, topics):
    """What makes the recording with other stamps in the headers of some topics."""
    def damage(folder):
        def changed(topic, message):
            if topic not in topics:
                return message
            stamp = message.header.stamp
            ns = new_stamp_ns(stamp.sec * 10**9 + stamp.nanosec)
            return replace(message, header=replace(message.header, stamp=make(
                "builtin_interfaces/msg/Time", sec=ns // 10**9, nanosec=ns % 10**9)))
        return write(folder / "bag", [(t, topic, kind, changed(topic, message))
                                      for t, topic, kind, message in said()])
    return damage


def without_index(folder):
    return bare_mcap(folder / "a.mcap", messages_of(write(folder / "made", said())), True,
                     index_types=IndexType.NONE, use_statistics=False)


def _made(folder, form):
    return form(folder, messages_of(write(folder / "made", said())))


def _database(folder):
    return _made(folder, lambda f, m: bare(rosbag2(f / "bag", m, SQLITE), ".db3", f / "a.db3"))


def _ros1(folder):
    return _made(folder, lambda f, m: ros1(f / "a.bag", m))


def _packed(folder):
    return _made(folder, lambda f, m: packed(bare_mcap(f / "a.mcap", m, True), f / "b.mcap.zstd"))


CAMERA = (COLOR, DEPTH, INFO)
# By name: what makes it in a folder and returns its path.
DAMAGED = {
    **{f"mcap, {share:.1%} of it": cut(share) for share in (0.05, 0.6, 0.999)},
    **{f"mcap, 8 bits flipped ({seed})": flipped(seed) for seed in range(3)},
    "mcap without an index": without_index,
    "db3, 60% of it": cut(0.6, _database),
    "ROS 1, 60% of it": cut(0.6, _ros1),
    "mcap.zstd, 60% of it": cut(0.6, _packed),
    "stamps wrap after three images": restamped(
        lambda ns: ns + 10**12 if ns <= 3 * 10**9 else ns + 10**12 - WRAP_NS // 10**5, CAMERA),
    "stamps are 0": restamped(lambda ns: 0, CAMERA),
    "the camera has another clock than the arm": restamped(lambda ns: ns + 10**12, CAMERA),
    "depth has another clock than colour": restamped(lambda ns: ns + 10**12, (DEPTH,)),
    "depth's clock is 3 ms late": restamped(lambda ns: ns + 3 * 10**6, (DEPTH,)),
}
