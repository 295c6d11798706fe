# SPDX-License-Identifier: Apache-2.0
"""What makes a view: partners and calibration of its time, whatever the order of arrival."""

import random
from dataclasses import replace

import numpy as np
import pytest
from kits.moving_camera import (
    CAMERA,
    COLOR_ONLY,
    FRAME,
    METRES,
    MS,
    WITH_DEPTH,
    add_tf,
    camera_pose,
    check_skip,
    collected,
    feed,
    picture,
    stamp_of,
)
from kits.recording_kit import camera_info, compressed, image, pose_stamped, transform

from stack_counter import geometry
from stack_counter.types import Intrinsics
from stack_counter.views import decoding
from stack_counter.views.assembler import ViewAssembler


def test_a_view_holds_what_was_sent():
    views, assembler = collected(replace(WITH_DEPTH, labels_topic=""))
    assert assembler.tally.used == 4 and not assembler.tally.skipped
    view = views[2]
    assert (view.stamp_ns, view.camera, view.fixed) == (stamp_of(2), FRAME, False)
    assert view.intrinsics == CAMERA
    np.testing.assert_allclose(view.T_world_camera, camera_pose(2), atol=1e-9)
    assert np.array_equal(view.color, picture(2)) and np.array_equal(view.depth, METRES)


@pytest.mark.parametrize("reason, fault, said", [
    ("bad_encoding", {"color": image(picture(1), "yuv411", stamp_of(1))},
     ["yuv411", "rgb8", "/camera/color/image_raw: "]),
    ("size_mismatch", {"color": image(picture(1)[:40], "rgb8", stamp_of(1))}, ["64x40", "64x48"]),
    ("bad_intrinsics", {"info": camera_info(replace(CAMERA, fx=0.0), stamp_of(1))}, ["fx 0.0"]),
    ("bad_intrinsics", {"info": camera_info(replace(CAMERA, cy=np.nan), stamp_of(1))}, ["nan"]),
    ("bad_depth", {"depth": METRES[:40]}, ["64x40", "64x48"]),
    ("empty_depth", {"depth": METRES * np.nan}, ["invalid"]),
    ("bad_encoding", {"depth": image(picture(1), "rgb8", stamp_of(1))}, ["rgb8", "16UC1"]),
    ("unsynchronised", {"depth": None}, ["5.0 ms"]),
    ("no_tf", {"tf": False}, ["ms before", "100 ms"]),
    ("frame_changed", {"color": image(picture(1), "rgb8", stamp_of(1), "other")},
     ["'other'", f"'{FRAME}'"]),
])
def test_a_faulty_image_is_skipped_with_its_reason(reason, fault, said):
    text = check_skip(reason, WITH_DEPTH, **fault)
    assert all(word in text for word in said), text


def test_time_going_backwards_and_standing_still():
    old = image(picture(9), "rgb8", stamp_of(0) - 1)
    assert "expected" in check_skip("time_backwards", COLOR_ONLY, color=old)
    check_skip("same_stamp", COLOR_ONLY, color=image(picture(9), "rgb8", stamp_of(0)))


def test_label_images():
    config = replace(COLOR_ONLY, labels_topic="/labels")
    assembler = ViewAssembler(config, live=False)
    for i, value in enumerate((1, 3, 2, 2)):
        feed(assembler, i)
        labels = np.full((40 if i == 2 else 48, 64), value, np.uint8)
        assembler.add_labels(image(labels, "mono8", stamp_of(i)))
    views = assembler.flush()
    assert [int(v.labels.max()) for v in views] == [1, 2]
    assert assembler.tally.skipped == {"bad_labels": 2}


def test_no_camera_info_at_all():
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    for i in range(3):
        assembler.add_color(image(picture(i), "rgb8", stamp_of(i)))
        add_tf(assembler, i)
    assert assembler.poll() == [] and assembler.flush() == []
    assert assembler.tally.skipped == {"no_camera_info": 3}


@pytest.mark.parametrize("order", ["info first", "info last"])
def test_camera_info_sent_once(order):
    assembler, views = ViewAssembler(COLOR_ONLY, live=False), []
    if order == "info first":
        assembler.add_camera_info(camera_info(CAMERA, 0))
    for i in range(6):
        assembler.add_color(image(picture(i), "rgb8", stamp_of(i)))
        add_tf(assembler, i)
        views += assembler.poll()
        if order == "info first" and i >= 3:  # only the first wait for one of their own
            assert len(views) == i + 1
    if order == "info last":
        assembler.add_camera_info(camera_info(CAMERA, stamp_of(5)))
    assert len(views + assembler.flush()) == 6


def test_tf_loop():
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    feed(assembler, 0)
    assembler.add_transform(transform(0, np.eye(4), "base_link", FRAME), True)
    assert assembler.poll() == [] and assembler.tally.skipped == {"tf_loop": 1}


def test_a_broken_transform_is_dropped_and_told():
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    broken = transform(stamp_of(0), np.eye(4))
    broken.transform.translation.x = np.nan
    assembler.add_transform(broken, False)
    feed(assembler, 0, tf=False)
    assert assembler.flush() == []
    assert assembler.tally.skipped == {"no_tf": 1} and "nan" in assembler.last_error["bad_pose"]


def test_poses_of_a_topic():
    config = replace(COLOR_ONLY, pose_source="topic")
    assembler = ViewAssembler(config, live=False)
    for i in range(3):
        feed(assembler, i, tf=False)
        assembler.add_pose(pose_stamped(stamp_of(i), camera_pose(i)))
    views = assembler.poll()
    assert len(views) == 3
    np.testing.assert_allclose(views[2].T_world_camera, camera_pose(2), atol=1e-9)


def test_the_nearest_depth_is_taken_even_if_another_is_there_first():
    config = replace(WITH_DEPTH, sync_tolerance_s=0.12)
    assembler = ViewAssembler(config, live=False)
    assembler.add_depth(image(METRES * 2, "32FC1", stamp_of(0) - 99 * MS))
    feed(assembler, 0, depth=None)
    assert assembler.poll() == []  # a nearer one may come
    assembler.add_depth(image(METRES, "32FC1", stamp_of(0) + 2 * MS))
    assert assembler.poll()[0].depth[0, 0] == 0.5


def scene_events():
    """Messages by topic, each topic in order, with some of each kind of fault."""
    events = {"color": [], "info": [], "depth": [], "tf": []}
    for i in range(12):
        stamp = stamp_of(i)
        k = replace(CAMERA, fx=0.0) if i == 7 else replace(CAMERA, cx=31.5 + i // 4)
        color = compressed(picture(i), stamp_ns=stamp)
        depth = image(METRES[:40] if i == 3 else METRES + i, "32FC1", stamp - (i % 3) * MS)
        events["color"].append(lambda a, m=color: a.add_color(m))
        events["info"].append(lambda a, m=camera_info(k, stamp): a.add_camera_info(m))
        if i != 5:
            events["depth"].append(lambda a, m=depth: a.add_depth(m))
        if i != 9:
            events["tf"].append(lambda a, i=i: add_tf(a, i))
    return events


def replayed(seed, ahead=3):
    """Feeds the events in random order between topics, none ahead of another by more."""
    events, chance = scene_events(), random.Random(seed)
    assembler, views = ViewAssembler(WITH_DEPTH, live=False), []
    done = dict.fromkeys(events, 0)
    while open_topics := [t for t in events if done[t] < len(events[t])]:
        least = min(done[t] for t in open_topics)
        topic = chance.choice([t for t in open_topics if done[t] < least + ahead])
        events[topic][done[topic]](assembler)
        done[topic] += 1
        if chance.random() < 0.7:
            views += assembler.poll()
    views += assembler.flush()
    return [(v.stamp_ns, v.intrinsics, v.T_world_camera.tobytes(), v.depth.tobytes())
            for v in views], assembler.tally


def test_the_order_of_arrival_between_topics_does_not_matter():
    views, tally = replayed(0)
    assert len(views) == 8
    assert tally.skipped == {"bad_depth": 1, "unsynchronised": 1, "bad_intrinsics": 1, "no_tf": 1}
    for seed in range(1, 60):
        assert replayed(seed) == (views, tally), f"order {seed}"


def test_live_gives_up_after_the_timeout_and_replay_never():
    for live, expected in ((True, {"no_tf": 1}), (False, {})):
        assembler = ViewAssembler(replace(COLOR_ONLY, tf_timeout_s=0.0), live=live)
        feed(assembler, 0, tf=False)
        assert assembler.poll() == [] and assembler.tally.skipped == expected
        add_tf(assembler, 0)
        assert len(assembler.poll()) == (0 if live else 1)


def test_what_waits_is_bounded():
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    for i in range(100):
        feed(assembler, i, tf=False)
        assembler.poll()
    assert assembler.tally.skipped == {"no_tf": 70}


def test_a_new_scan_keeps_poses_and_calibration(caplog):
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    assembler.add_camera_info(camera_info(CAMERA, 0))
    assembler.add_transform(transform(0, camera_pose(0)), True)
    for _ in range(2):
        assembler.start()
        for stamp in (stamp_of(5), stamp_of(4), stamp_of(3)):
            assembler.add_color(image(picture(), "rgb8", stamp))
        assert len(assembler.flush()) == 1
        assert assembler.tally.skipped == {"time_backwards": 2}
    assert len(caplog.records) == 2  # once for each scan, though counted twice in each


def test_calibration_of_a_part_of_the_sensor():
    """A point keeps its place in the picture, whether cut and binned by the driver or by us."""
    full = Intrinsics(640, 480, 600.0, 620.0, 320.0, 240.0)
    message = camera_info(full)
    message = replace(message, binning_x=2, binning_y=2, roi=replace(
        message.roi, x_offset=100, y_offset=40, width=400, height=300))
    seen = decoding.intrinsics_of_camera_info(message)
    assert (seen.width, seen.height) == (200, 150)
    point = np.array([0.1, -0.05, 0.8])
    pixel, _ = geometry.project(point, full)
    np.testing.assert_allclose(geometry.project(point, seen)[0], (pixel - [100, 40]) / 2)
