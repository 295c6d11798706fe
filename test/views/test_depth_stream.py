# SPDX-License-Identifier: Apache-2.0
"""Depth that is not aligned with colour is registered, or its views are refused."""

from dataclasses import replace

import numpy as np
import pytest
from kits.depth_camera import (
    COLOR_CAMERA,
    DEPTH_FRAME,
    FILL,
    INNER,
    OTHER_SIZE,
    OWN_DEPTH,
    OWN_INFO,
    SAME_SIZE,
    own_depth_records,
    own_depth_scan,
)
from kits.moving_camera import CAMERA, METRES, WITH_DEPTH, add_tf, picture, stamp_of
from kits.recording_kit import FRAME, INFO, camera_info, image, tf_record, transform, write

from stack_counter.bag.bag_views import BagViews
from stack_counter.bag.replay import measure_bag
from stack_counter.config import CollectorConfig, Config
from stack_counter.views.assembler import ViewAssembler
from stack_counter.views.depth_stream import FoundDepth, depth_camera_info_topic

OWN = CollectorConfig(depth_topic=OWN_DEPTH)


def read(path, config=OWN):
    bag = BagViews(path, config)
    return [view for _, view in bag], bag.assembler


@pytest.mark.parametrize("camera", [SAME_SIZE, OTHER_SIZE], ids=["same size", "other size"])
def test_depth_of_a_camera_beside_colour_is_registered(tmp_path, camera):
    path = write(tmp_path / "bag", own_depth_records(camera))
    views, assembler = read(path)
    assert len(views) == 6 and not assembler.tally.skipped
    for view, truth in zip(views, own_depth_scan(camera)[0]):
        assert view.intrinsics == COLOR_CAMERA and view.depth.shape == truth.depth.shape
        error = (view.depth - truth.depth)[view.depth > 0]
        assert (view.depth > 0).mean() > 0.95 and np.median(np.abs(error)) < 0.001
    volume = measure_bag(path, Config(collector=OWN)).stack_volume
    assert volume == pytest.approx(np.prod(INNER[:2]) * FILL, rel=0.05)


def test_a_frame_that_is_the_same_does_not_hide_another_calibration(tmp_path):
    """As where one camera gives colour and depth through two lenses of one place."""
    views, _ = own_depth_scan(SAME_SIZE)
    (view, *_), _ = read(write(tmp_path / "bag", own_depth_records(
        SAME_SIZE, frame=FRAME, tf=False)))
    # Registered as if both cameras were at one place: off by the 15 mm between them, no more.
    inside = view.depth > 0
    assert inside.mean() > 0.9
    assert np.median(np.abs(view.depth - views[0].depth)[inside]) < 0.004


@pytest.mark.parametrize("left_out, said", [
    ("info", "no calibration on /camera/depth/camera_info; expected calibration and /tf_static"),
    ("tf", f"depth is of '{DEPTH_FRAME}', colour of '{FRAME}', and no_tf: no transforms connect")])
def test_what_cannot_be_registered_is_refused_with_advice(tmp_path, left_out, said):
    views, assembler = read(write(tmp_path / "bag", own_depth_records(**{left_out: False})))
    assert not views and assembler.tally.skipped == {"depth_not_aligned": 6}
    (line,) = assembler.last_errors
    assert said in line and f"set depth_camera_info_topic to {INFO}" in line


def test_depth_can_be_declared_aligned(tmp_path):
    path = write(tmp_path / "bag", own_depth_records(info=False, tf=False))
    views, assembler = read(path, replace(OWN, depth_camera_info_topic=INFO))
    assert len(views) == 6 and not assembler.tally.skipped
    millimetres = np.round(own_depth_scan()[1][0].depth * 1000)
    np.testing.assert_allclose(views[0].depth * 1000, millimetres, atol=0.01)


def test_a_place_from_which_nothing_is_seen_in_common_is_refused(tmp_path):
    aside = np.eye(4)
    aside[0, 3] = 3.0
    records = [*own_depth_records(tf=False),
               tf_record(1, aside, DEPTH_FRAME, FRAME, "/tf_static")]
    _, assembler = read(write(tmp_path / "bag", records))
    assert assembler.tally.skipped == {"empty_depth": 6}
    assert "check the transform between them" in assembler.last_errors[0]


def test_depth_of_another_size_than_its_calibration_is_refused(tmp_path):
    halved = replace(SAME_SIZE, width=160, height=120)
    records = [(*r[:3], camera_info(halved, r[0], DEPTH_FRAME)) if r[1] == OWN_INFO else r
               for r in own_depth_records()]
    _, assembler = read(write(tmp_path / "bag", records))
    assert assembler.tally.skipped == {"bad_depth": 6}
    assert "depth of 320x240; expected 160x120 as its calibration" in assembler.last_errors[0]


@pytest.mark.parametrize("settings, topic", [
    ({}, "/camera/aligned_depth_to_color/camera_info"),
    ({"depth_topic": OWN_DEPTH}, OWN_INFO),
    ({"depth_topic": ""}, ""),
    ({"depth_camera_info_topic": "/x"}, "/x"),
    ({"depth_camera_info_topic": INFO}, "")])
def test_where_the_depth_calibration_comes_from(settings, topic):
    assert depth_camera_info_topic(CollectorConfig(**settings)) == topic


# --- one message at a time -----------------------------------------------------------------------

T_BESIDE = np.eye(4)
T_BESIDE[0, 3] = 0.02


def live(depth_frame, own=None, config=WITH_DEPTH):
    """An assembler with one image's colour, depth, calibration and pose."""
    assembler = ViewAssembler(config)
    assembler.add_camera_info(camera_info(CAMERA, stamp_of(0)))
    if own is not None:
        assembler.add_depth_camera_info(camera_info(own, stamp_of(0), depth_frame))
    assembler.add_color(image(picture(), "rgb8", stamp_of(0)))
    assembler.add_depth(image(METRES, "32FC1", stamp_of(0), depth_frame))
    add_tf(assembler, 0)
    return assembler


@pytest.mark.parametrize("frame", ["", FRAME, "/" + FRAME])
def test_aligned_depth_waits_for_nothing_and_is_left_alone(frame):
    (view,) = live(frame).poll()
    np.testing.assert_array_equal(view.depth, METRES)
    assert view.intrinsics == CAMERA
    (view,) = live(frame, CAMERA).poll()
    np.testing.assert_array_equal(view.depth, METRES)


def test_aligned_depth_may_have_a_frame_that_nobody_publishes():
    (view,) = live("aligned_depth_frame", replace(CAMERA, fx=CAMERA.fx + 0.1)).poll()
    np.testing.assert_array_equal(view.depth, METRES)


def test_another_camera_waits_for_calibration_and_place():
    other = replace(CAMERA, fx=120.0, fy=120.0)
    assembler = live("depth_frame")
    assert not assembler.poll()
    assembler.add_depth_camera_info(camera_info(other, stamp_of(0), "depth_frame"))
    assert not assembler.poll()
    assembler.add_transform(transform(0, T_BESIDE, "depth_frame", FRAME), static=True)
    (view,) = assembler.poll()
    # A wall at 0.5 m: the depth camera sees half as much of it, 2 cm to the right.
    columns = np.flatnonzero(view.depth[24])
    assert abs(len(columns) - 32) <= 1
    assert abs(columns.mean() - (CAMERA.cx + 0.02 * CAMERA.fx / 0.5)) < 1
    assert np.ptp(view.depth[view.depth > 0]) < 1e-6


def test_two_cameras_of_one_kind_side_by_side_are_told_apart_by_tf():
    assembler = live("right_frame", CAMERA)
    assembler.add_transform(transform(0, T_BESIDE, "right_frame", FRAME), static=True)
    (view,) = assembler.poll()
    shift = round(0.02 * CAMERA.fx / 0.5)
    assert not view.depth[:, :shift].any() and view.depth[:, shift + 1:].all()


def test_lenses_that_distort_are_rectified_first():
    """The view becomes a pinhole camera's, since depth is projected into its pixels."""
    (view,) = live("", config=WITH_DEPTH).poll()
    bent = replace(view, intrinsics=replace(CAMERA, distortion=(0.1, -0.05, 0.0, 0.0, 0.0)))
    depth = FoundDepth(METRES, replace(CAMERA, fx=50.0, fy=50.0, distortion=()), T_BESIDE)
    straight, registered = depth.added_to(view), depth.added_to(bent)
    assert not registered.intrinsics.distortion
    np.testing.assert_array_equal(registered.depth, straight.depth)
    assert not np.array_equal(registered.color, straight.color)


def test_a_topic_that_is_named_must_speak():
    config = replace(WITH_DEPTH, depth_camera_info_topic="/depth_info")
    assembler = live(FRAME, config=config)
    assert not assembler.poll() and not assembler.flush()
    assert assembler.tally.skipped == {"depth_not_aligned": 1}
    uncalibrated = replace(CAMERA, fx=0.0, fy=0.0)
    (view,) = live(FRAME, uncalibrated, config).poll()
    np.testing.assert_array_equal(view.depth, METRES)
