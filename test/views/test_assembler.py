# SPDX-License-Identifier: Apache-2.0
"""Views from messages, with the bag reader's decoded messages as input."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from kits.bags import FRAME, bag, bin_views, picture

from stack_counter.bag.bag_views import subscribed_topics
from stack_counter.bag.camera_topics import fit_camera_to_bag
from stack_counter.bag.reader import BagReader
from stack_counter.config import CollectorConfig
from stack_counter.views.assembler import ViewAssembler
from stack_counter.views.rig import load_rig
from stack_counter.views.rig_assembler import RigAssembler


def load(path):
    """Topic and message of every record, and the settings that fit."""
    reader = BagReader(path)
    config = fit_camera_to_bag(CollectorConfig(), reader.topics)
    topics = subscribed_topics(RigAssembler(load_rig(config)))
    return [(r.topic, r.decode()) for r in reader.records(set(topics))], config


def feed(records, config):
    assembler, views = ViewAssembler(config), []
    takers = {config.camera_info_topic: assembler.add_camera_info,
              config.depth_topic: assembler.add_depth, config.labels_topic: assembler.add_labels}
    for topic, message in records:
        if topic == "/tf":
            for transform in message.transforms:
                assembler.add_transform(transform, False)
        else:
            takers.get(topic, assembler.add_color)(message)
        views += assembler.poll()
    return views + assembler.flush(), assembler


def is_color(topic):
    return topic.startswith("/camera/color/image_raw")


@pytest.mark.parametrize("seed", range(4))
def test_views_do_not_depend_on_the_order_in_which_topics_arrive(tmp_path, seed):
    records, config = load(bag(tmp_path))
    straight, _ = feed(records, config)
    random = np.random.default_rng(seed)
    queues = {topic: [r for r in records if r[0] == topic] for topic, _ in records}
    mixed = []
    while queues:
        topic = random.choice(sorted(queues))
        mixed.append(queues[topic].pop(0))
        if not queues[topic]:
            del queues[topic]
    shuffled, _ = feed(mixed, config)
    assert len(straight) == 6 and [v.stamp_ns for v in shuffled] == [v.stamp_ns for v in straight]
    for a, b in zip(straight, shuffled):
        np.testing.assert_array_equal(a.depth, b.depth)
        np.testing.assert_array_equal(a.color, b.color)
        np.testing.assert_array_equal(a.T_world_camera, b.T_world_camera)


def test_views_are_those_that_were_written(tmp_path):
    views = bin_views()
    got, assembler = feed(*load(bag(tmp_path, views)))
    for view, back in zip(views, got):
        np.testing.assert_allclose(back.depth, view.depth, atol=0.00051)
        np.testing.assert_allclose(back.T_world_camera, view.T_world_camera, atol=1e-9)
        assert back.camera == FRAME and not back.fixed
    assert assembler.tally.used == 6 and not assembler.tally.skipped


def skipped(tmp_path, views):
    return feed(*load(bag(tmp_path, views)))[1].tally.skipped


def test_blurred_and_unmoved_views_are_skipped(tmp_path):
    views = bin_views()
    views[1] = replace(views[1], color=np.full_like(views[1].color, 90))
    views[3] = replace(views[2], stamp_ns=views[3].stamp_ns)
    assert skipped(tmp_path, views) == {"blurred": 1, "duplicate": 1}


def test_missing_partners_second_camera_and_time_backwards(tmp_path):
    records, config = load(bag(tmp_path))
    colors = [m for t, m in records if is_color(t)]
    without = [r for r in records if not (r[0] == config.depth_topic
                                          and r[1].header.stamp.sec == 3)]
    assert feed(without, config)[1].tally.skipped == {"unsynchronised": 1}
    again = records + [("/camera/color/image_raw/compressed", colors[2])]
    assert feed(again, config)[1].tally.skipped == {"time_backwards": 1}
    twice = records + [("/camera/color/image_raw/compressed", colors[-1])]
    assert feed(twice, config)[1].tally.skipped == {"same_stamp": 1}
    colors[4].header.frame_id = "other_camera"
    _, assembler = feed(records, config)
    assert assembler.tally.skipped == {"frame_changed": 1}
    assert "other_camera" in assembler.last_error["frame_changed"]


def test_calibration_of_another_size_or_none(tmp_path):
    records, config = load(bag(tmp_path))
    infos = [m for t, m in records if t == config.camera_info_topic]
    none = [r for r in records if r[0] != config.camera_info_topic]
    assert feed(none, config)[1].tally.skipped == {"no_camera_info": 6}
    infos[0].width = 320
    infos[1].k, infos[1].p = [0.0] * 9, [0.0] * 12
    _, assembler = feed(records, config)
    assert assembler.tally.skipped == {"size_mismatch": 1, "bad_intrinsics": 1}
    assert "expected 320x120" in assembler.last_error["size_mismatch"]


def test_depth_of_another_size_and_all_invalid(tmp_path):
    views = bin_views()
    views[0] = replace(views[0], depth=views[0].depth[:60])
    views[2] = replace(views[2], depth=np.zeros_like(views[2].depth))
    assert skipped(tmp_path, views) == {"bad_depth": 1, "empty_depth": 1}


def test_no_tf(tmp_path):
    views = bin_views()
    transforms = [(v.stamp_ns + d, "base_link", FRAME, v.T_world_camera)
                  for v in views[:4] for d in (-10**7, 10**7)]
    path = bag(tmp_path, views, transforms=transforms)
    assert feed(*load(path))[1].tally.skipped == {"no_tf": 2}


def test_fixed_camera_is_gated_on_change(tmp_path):
    first = replace(bin_views(count=1)[0], T_world_camera=np.eye(4))
    views = [replace(first, stamp_ns=(i + 1) * 10**9, color=picture(i // 2)) for i in range(6)]
    records, config = load(bag(tmp_path, views, transforms=[(1, "base_link", FRAME, np.eye(4))]))
    assembler = ViewAssembler(config)
    for topic, message in records:
        if topic == "/tf":
            assembler.add_transform(message.transforms[0], static=True)
        elif is_color(topic):
            assembler.add_color(message)
        elif topic == config.depth_topic:
            assembler.add_depth(message)
        else:
            assembler.add_camera_info(message)
    got = assembler.flush()
    assert [v.stamp_ns for v in got] == [10**9, 3 * 10**9, 5 * 10**9]
    assert all(v.fixed for v in got) and assembler.tally.skipped == {"duplicate": 3}


def test_poses_from_a_topic_are_those_of_tf(tmp_path):
    records, config = load(bag(tmp_path))
    by_tf, _ = feed(records, config)
    topic = replace(config, pose_source="topic")
    assembler, views = ViewAssembler(topic), []
    takers = {config.camera_info_topic: assembler.add_camera_info,
              config.depth_topic: assembler.add_depth}
    for name, message in records:
        if name != "/tf":
            takers.get(name, assembler.add_color)(message)
        else:
            for t in message.transforms:
                pose = SimpleNamespace(position=t.transform.translation,
                                       orientation=t.transform.rotation)
                assembler.add_pose(SimpleNamespace(header=t.header, pose=pose))
        views += assembler.poll()
    views += assembler.flush()
    assert len(views) == len(by_tf) == 6
    for a, b in zip(views, by_tf):
        np.testing.assert_array_equal(a.T_world_camera, b.T_world_camera)


def test_a_bag_that_is_played_again_is_not_late_for_ever(tmp_path):
    records, config = load(bag(tmp_path))
    views, assembler = feed(records + records, config)
    assert len(views) == 11 and assembler.tally.skipped == {"time_backwards": 1}


def test_a_fixed_pose_needs_no_transforms(tmp_path):
    records, config = load(bag(tmp_path))
    T = np.diag([1.0, -1, -1, 1])
    assembler, views = ViewAssembler(config, T_world_camera=T), []
    for topic, message in records:
        takers = {config.camera_info_topic: assembler.add_camera_info,
                  config.depth_topic: assembler.add_depth}
        if topic != "/tf":
            takers.get(topic, assembler.add_color)(message)
        views += assembler.poll()
    views += assembler.flush()
    assert len(views) >= 1 and all(
        v.fixed and np.array_equal(v.T_world_camera, T) for v in views)
