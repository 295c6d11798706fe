# SPDX-License-Identifier: Apache-2.0
"""What keeps an image from being a view: no motion, no change, blur."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from kits.moving_camera import (
    CAMERA,
    COLOR_ONLY,
    MS,
    camera_pose,
    check_skip,
    collected,
    feed,
    picture,
    stamp_of,
)
from kits.recording_kit import WORLD, camera_info, image, pose_stamped, transform

from stack_counter.views.assembler import ViewAssembler


def test_moving_camera_must_move():
    still = replace(COLOR_ONLY, min_motion_m=0.03, min_motion_rad=3.0)  # it moves 2 cm a view
    views, assembler = collected(still)
    assert [v.stamp_ns for v in views] == [stamp_of(0), stamp_of(2)]
    assert assembler.tally.skipped == {"duplicate": 2}
    assert "0.0200 m" in assembler.last_error["duplicate"]


def test_fixed_camera_must_see_a_change_not_noise():
    assembler, noise = ViewAssembler(COLOR_ONLY, live=False), np.random.default_rng(0)
    assembler.add_transform(transform(0, camera_pose(0)), True)
    for i, scene in enumerate((0, 0, 0, 1, 1)):
        large = cv2.resize(picture(scene), (640, 480), interpolation=cv2.INTER_NEAREST)
        large = np.clip(large + noise.normal(0, 5, large.shape), 0, 255).astype(np.uint8)
        k = replace(CAMERA, width=640, height=480)
        feed(assembler, i, image(large, "rgb8", stamp_of(i)), camera_info(k, stamp_of(i)),
             tf=False)
    views = assembler.flush()
    assert [v.stamp_ns for v in views] == [stamp_of(0), stamp_of(3)]
    assert all(v.fixed for v in views) and assembler.tally.skipped == {"duplicate": 3}


def test_one_part_taken_away_is_a_change():
    """A patch of 40 x 40 pixels that becomes darker by 20 levels, among noise."""
    assembler, noise = ViewAssembler(COLOR_ONLY, live=False), np.random.default_rng(0)
    assembler.add_transform(transform(0, camera_pose(0)), True)
    k = replace(CAMERA, width=640, height=480)
    plain = cv2.resize(picture(0), (640, 480), interpolation=cv2.INTER_NEAREST).astype(float)
    for i in range(3):
        shown = np.clip(plain, 40, 215)
        shown[200:240, 300:340] -= 20.0 * (i == 2)
        shown = np.clip(shown + noise.normal(0, 5, shown.shape), 0, 255).astype(np.uint8)
        feed(assembler, i, image(shown, "rgb8", stamp_of(i)), camera_info(k, stamp_of(i)),
             tf=False)
    assert [v.stamp_ns for v in assembler.flush()] == [stamp_of(0), stamp_of(2)]


@pytest.mark.parametrize("mode", ["scan", "continuous"])
@pytest.mark.parametrize("source", ["tf_static", "tf", "joints at 2 Hz", "topic"])
def test_a_camera_that_stands_sees_every_part_taken_wherever_its_pose_comes_from(mode, source):
    """Four pictures, two images of each; parts are taken in between."""
    config = replace(COLOR_ONLY, mode=mode, pose_source="topic" if source == "topic" else "tf",
                     world_frame=WORLD)
    assembler = ViewAssembler(config, live=False)
    if source == "tf_static":
        assembler.add_transform(transform(0, camera_pose(0)), True)
    for i in range(8):
        feed(assembler, i, image(picture(i // 2), "rgb8", stamp_of(i)), tf=False)
        for offset in (-20, 20):
            stamp = stamp_of(i) + offset * MS
            if source == "tf":
                assembler.add_transform(transform(stamp, camera_pose(0)), False)
            if source == "topic":
                assembler.add_pose(pose_stamped(stamp, camera_pose(0)))
    for i in range(4) if source == "joints at 2 Hz" else ():
        assembler.add_transform(transform(i * 500 * MS, camera_pose(0)), False)
    assert [v.stamp_ns for v in assembler.flush()] == [stamp_of(i) for i in (0, 2, 4, 6)]
    assert assembler.tally.skipped == {"duplicate": 4}


@pytest.mark.parametrize("mode", ["scan", "continuous"])
def test_a_camera_that_is_brought_back_sees_the_change(mode):
    """Its pose is off by 0.3 mm each time; that alone is nothing new."""
    assembler = ViewAssembler(replace(COLOR_ONLY, mode=mode), live=False)
    smooth = [cv2.GaussianBlur(picture(seed), (0, 0), 3) for seed in (0, 1)]
    for i, seed in enumerate((0, 0, 1, 1, 0)):
        feed(assembler, i, image(smooth[seed], "rgb8", stamp_of(i)), tf=False)
        T = camera_pose(0)
        T[0, 3] += 0.0003 * (i % 3)
        for offset in (-20, 20):
            assembler.add_transform(transform(stamp_of(i) + offset * MS, T), False)
    assert [v.stamp_ns for v in assembler.flush()] == [stamp_of(i) for i in (0, 2, 4)]


def test_fixed_camera_that_changes_its_size():
    assembler = ViewAssembler(COLOR_ONLY, live=False)
    assembler.add_transform(transform(0, camera_pose(0)), True)
    feed(assembler, 0, tf=False)
    half = replace(CAMERA, width=32, height=24)
    feed(assembler, 1, image(picture(5, half), "rgb8", stamp_of(1)),
         camera_info(half, stamp_of(1)), tf=False)
    assert [v.color.shape for v in assembler.flush()] == [(48, 64, 3), (24, 32, 3)]


def test_blurred_images_are_skipped():
    blurred = cv2.GaussianBlur(picture(1), (0, 0), 6)
    text = check_skip("blurred", replace(COLOR_ONLY, min_sharpness=20.0),
                      color=image(blurred, "rgb8", stamp_of(1)))
    assert "at least 20" in text
