# SPDX-License-Identifier: Apache-2.0
"""What the fuzzer feeds: files of recordings, and messages."""

import tempfile
from functools import lru_cache
from pathlib import Path

import numpy as np
from kits.bag_formats import FORMATS, bare_mcap, messages_of
from kits.own_messages import OWN_MESSAGES
from kits.packed_depth import packed, png, rvl
from kits.recording_kit import (
    COLOR,
    COMPRESSED,
    DEPTH,
    FRAME,
    compressed,
    make,
    records,
    scan,
    tf_record,
    write,
)
from mcap.writer import CompressionType
from rclpy.serialization import deserialize_message, serialize_message

from stack_counter.bag.bag_scale import BagScale
from stack_counter.bag.bag_views import SCALE_TOPIC, BagViews, read_views, with_scale_of_bag
from stack_counter.bag.camera_topics import fit_rig_to_bag
from stack_counter.bag.formats.recording_file import TopicDecoder
from stack_counter.bag.info import describe_bag
from stack_counter.bag.scan_file import Received, Recording
from stack_counter.config import CollectorConfig, Config, CounterConfig
from stack_counter.types import Intrinsics
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler

TINY = Intrinsics(16, 12, 15.2, 15.2, 7.5, 5.5)
FLOAT, WEIGHT = "std_msgs/msg/Float64", "/weight"
COUNTER = CounterConfig(weight_topic=WEIGHT)


@lru_cache
def messages(depth=None):
    """(log time ns, topic, type, CDR) of a scan of two views with all that a bag may say.

    Args:
        depth: `png` or `rvl`: depth and colour are compressed.
    """
    said = [tf_record(5, np.eye(4), "lens", FRAME, "/tf_static")]
    said += [(10**9, topic, FLOAT, make(FLOAT, data=0.01)) for topic in (SCALE_TOPIC, WEIGHT)]
    for stamp, topic, kind, message in records(scan(count=2, camera=TINY)):
        if depth and topic == DEPTH:
            pixels = np.frombuffer(message.data, np.uint16).reshape(12, 16)
            name = "16UC1; compressedDepth" + (" rvl" if depth is rvl else "")
            topic, kind = f"{DEPTH}/compressedDepth", COMPRESSED
            message = packed(depth(pixels), name, stamp)
        elif depth and topic == COLOR:
            pixels = np.frombuffer(message.data, np.uint8).reshape(12, 16, 3)
            topic, kind = f"{COLOR}/compressed", COMPRESSED
            message = compressed(pixels, ".jpg" if depth is rvl else ".png", stamp)
        said.append((stamp, topic, kind, message))
    with tempfile.TemporaryDirectory() as folder:
        return messages_of(write(Path(folder) / "bag", said))


def bags(*names):
    """What makes the bytes of the recording in some of the forms of `FORMATS`."""
    def make_all():
        for name in names:
            with tempfile.TemporaryDirectory() as folder:
                yield Path(FORMATS[name](Path(folder), messages())).read_bytes()
    return make_all


def mcap_files():
    """The recording without chunks, in chunks without check sums, and as recorders write it.

    The last one is our own recorder's, with what the scan had no time for.
    """
    plain = {"compression": CompressionType.NONE, "enable_crcs": False}
    for depth, options in ((None, {"use_chunking": False}), (None, plain), (png, {}),
                           (rvl, {"definitions": True})):
        with tempfile.TemporaryDirectory() as folder:
            yield bare_mcap(Path(folder) / "a.mcap", messages(depth), **options).read_bytes()
    with tempfile.TemporaryDirectory() as folder:
        recording = Recording(Path(folder), {"scan_id": "a"}, 0)
        for stamp, topic, kind, data in messages():
            recording.write(Received(topic, kind, data, stamp, stamp))
        recording.finish({"overrun": '[["camera", 5]]'})
        path, = Path(folder).iterdir()
        yield path.read_bytes()


def use_bag(path):
    """Reads a recording as `replay --direct` and `info` do."""
    bag = BagViews(path, CollectorConfig())
    with_scale_of_bag(Config(), bag.reader)
    BagScale(bag.reader, COUNTER).weighing_at(2 * 10**9)
    assert isinstance(bag.reader.overrun, set)
    for _ in bag:
        pass
    describe_bag(path, Config())


def metadata_files():
    with tempfile.TemporaryDirectory() as folder:
        yield (FORMATS["mcap by message"](Path(folder), messages()) / "metadata.yaml").read_bytes()


def use_metadata(path):
    """Reads a folder whose metadata.yaml this file is."""
    recording = path.parent / "bag.mcap"
    if not recording.exists():
        bare_mcap(recording, messages())
    use_bag(path)


# --- messages ---------------------------------------------------------------------------------

@lru_cache
def _recorded():
    """All recordings with the number of each message, one after the other."""
    return [(recording, number) for recording in map(messages, (None, png, rvl))
            for number in range(len(recording))]


class _OneChanged:
    """Stands in for a bag's reader: one message of the recording has other bytes."""

    def __init__(self, recording, number, data):
        self.topics = {m[1]: (m[2], 1) for m in recording}
        self._all = [(*m[:3], data if i == number else m[3]) for i, m in enumerate(recording)]

    def part(self, _):
        return self

    def records(self, topics, color_topics=frozenset()):
        return (_decoder(topic, kind).record(stamp, data)
                for stamp, topic, kind, data in self._all if topic in topics)


_decoder = lru_cache(TopicDecoder)


def camera_messages():
    """The number of a message in two bytes, and its CDR."""
    for at, (recording, number) in enumerate(_recorded()):
        yield at.to_bytes(2, "little") + recording[number][3]


def use_camera_message(path):
    data = path.read_bytes()
    recording, number = _recorded()[int.from_bytes(data[:2], "little") % len(_recorded())]
    reader = _OneChanged(recording, number, data[2:])
    with_scale_of_bag(Config(), reader)
    BagScale(reader, COUNTER).weighing_at(2 * 10**9)
    rig = fit_rig_to_bag(load_rig(CollectorConfig()), reader.topics)
    for _ in read_views(reader, RigAssembler(rig, live=False)):
        pass


def own_message(kind):
    """(what makes, what uses) the bytes of a message between our nodes."""
    make_one, use = OWN_MESSAGES[kind]

    def use_message(path):
        try:
            message = deserialize_message(path.read_bytes(), kind)
        except Exception:  # the middleware drops it
            return
        use(message)
    return lambda: [serialize_message(make_one())], use_message
