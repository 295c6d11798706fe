# SPDX-License-Identifier: Apache-2.0
"""What keeps an image from being a view: no motion, no change, blur."""

from dataclasses import replace

import cv2
import numpy as np
from kits.moving_camera import (
    CAMERA,
    COLOR_ONLY,
    camera_pose,
    check_skip,
    collected,
    feed,
    picture,
    stamp_of,
)
from kits.recording_kit import camera_info, image, transform

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
