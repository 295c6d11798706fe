# SPDX-License-Identifier: Apache-2.0
"""A scale in a bag: which weight belongs to the scan, and what the count makes of it."""

from dataclasses import replace

import pytest
from kits.bags import bag, bin_views
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from stack_counter.bag.bag_scale import BagScale, with_weight_of_bag
from stack_counter.bag.reader import BagReader
from stack_counter.bag.replay import replay_direct
from stack_counter.bag.time_range import TimeRange
from stack_counter.config import load_config
from stack_counter.errors import BagError
from stack_counter.files import config_path
from stack_counter.parts.catalogue import Part
from stack_counter.types import Reason
from stack_counter.weighing.joined_count import PieceWeight

S, KG = 10**9, "/scale/weight"
COLOR = {"/camera/color/image_raw/compressed"}
SHIPPED = load_config(config_path("stack_counter.yaml"))
CONFIG = replace(SHIPPED, counter=replace(SHIPPED.counter, estimator="prior", weight_topic=KG,
                                          tare_kg=1.0))
NUT = Part(1.5e-6, "nut", piece_weight=PieceWeight(0.012, 1.2e-4))


def weighed(tmp_path, *steps, name="weighed", kind="std_msgs/msg/Float64"):
    """A bag of views at 1 to 6 s with a scale; `steps`: from when on, s, it shows what, kg."""
    store = get_typestore(Stores.ROS2_JAZZY)
    with Reader(bag(tmp_path, name=f"{name}_views")) as source, \
            Writer(tmp_path / name, version=9, storage_plugin=StoragePlugin.MCAP) as target:
        kept = {c.id: target.add_connection(c.topic, c.msgtype, msgdef=c.msgdef.data,
                                            rihs01=c.digest) for c in source.connections}
        scale = target.add_connection(KG, kind, typestore=store)
        messages = [(stamp, kept[c.id], data) for c, stamp, data in source.messages()]
        for tenth in range(-20, 120):
            shown = [kg for begin, kg in steps if tenth >= 10 * begin]
            if shown:
                message = store.types[kind](data=shown[-1])
                messages.append((3 * S + tenth * S // 10, scale,
                                 store.serialize_cdr(message, kind)))
        for stamp, connection, data in sorted(messages, key=lambda m: m[0]):
            target.write(connection, stamp, data)
    return tmp_path / name


def at_end(path, config=CONFIG, **time_range):
    reader = BagReader(path, TimeRange(**time_range))
    return with_weight_of_bag(config, reader, COLOR).counter


def count_by_vision(tmp_path):
    alone = replace(CONFIG, counter=replace(CONFIG.counter, weight_topic=""))
    return replay_direct(bag(tmp_path), alone, NUT)[0].count.count


def test_the_weight_is_that_of_the_last_image(tmp_path):
    path = weighed(tmp_path, (-2, 3.2), (1.8, 4.4), (4, 1.0))  # at 1, 4.8 and 7 s of the bag
    assert BagReader(path).last_time_ns(COLOR) == 6 * S
    assert at_end(path).weight_kg == 4.4 and at_end(path).weight_topic == ""
    assert at_end(path, end_ns=2 * S).weight_kg == 3.2  # the bag begins at 1 s
    given = replace(CONFIG, counter=replace(CONFIG.counter, weight_kg=2.0))
    assert at_end(path, given).weight_kg == 2.0
    scale = BagScale(BagReader(path), CONFIG.counter)
    assert scale.weighing_at(6 * S).net_kg == pytest.approx(3.4)
    assert scale.weighing_at(30 * S).net_kg is None


def test_a_bag_without_the_topic_has_no_weight(tmp_path):
    path = bag(tmp_path, bin_views())
    assert at_end(path) == CONFIG.counter
    count = replay_direct(path, CONFIG, NUT)[0].count
    assert Reason.NO_WEIGHT in count.reasons and count.net_weight_kg is None


def test_another_type_of_message_is_refused(tmp_path):
    with pytest.raises(BagError, match="has messages std_msgs/msg/Float32; expected std_msgs"):
        at_end(weighed(tmp_path, (0, 3.2), kind="std_msgs/msg/Float32"))


def test_vision_and_scale_are_joined(tmp_path):
    vision = count_by_vision(tmp_path)
    right = weighed(tmp_path, (-2, 1.0 + 0.012 * (vision + 20)))
    count = replay_direct(right, CONFIG, NUT)[0].count
    assert count.count == pytest.approx(vision + 20, abs=1)
    assert count.count_interval[1] - count.count_interval[0] < 12
    assert [source.count for source in count.sources] == [vision, vision + 20]
    assert count.net_weight_kg == pytest.approx(0.012 * (vision + 20))
    foreign = replay_direct(weighed(tmp_path, (-2, 1.0 + 0.012 * 9 * vision), name="foreign"),
                            CONFIG, NUT)[0].count
    assert Reason.FOREIGN_PARTS_OR_WRONG_BIN in foreign.reasons and foreign.status == "degraded"
    assert foreign.count == vision


def test_live_counts_have_the_weight_of_their_time(tmp_path):
    """The bin shows the same all the time, and at 5 s the scale has something else on it."""
    vision = count_by_vision(tmp_path)
    path = weighed(tmp_path, (-2, 1.0 + 0.012 * vision), (0.5, 50.0))
    live = replace(CONFIG, reconstructor=replace(CONFIG.reconstructor, live=True))
    result, = replay_direct(path, live, NUT)
    widths = [high - low for low, high in (entry["count_interval"] for entry in result.counts)]
    assert len(widths) == 6 and max(widths[1:3]) < min(widths[4:])
    assert Reason.FOREIGN_PARTS_OR_WRONG_BIN in result.count.reasons
