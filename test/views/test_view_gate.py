# SPDX-License-Identifier: Apache-2.0
"""The gate: blur by the Laplacian's variance, motion of poses, change of what a fixed one sees."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.config import CollectorConfig
from stack_counter.errors import ViewError
from stack_counter.types import Intrinsics, View
from stack_counter.views.view_gate import ViewGate

CONFIG = CollectorConfig(min_motion_m=0.01, min_motion_rad=0.05, min_change=4.0,
                         min_sharpness=2.0)
NOISE = np.random.default_rng(0).integers(0, 255, (120, 160, 3)).astype(np.uint8)
SMOOTH = np.clip(100 + 3 * cv2.GaussianBlur(
    np.random.default_rng(2).normal(0, 60, (120, 160, 3)), (0, 0), 2), 0, 200).astype(np.uint8)
FLAT = np.full((120, 160), 0.5, np.float32)


def view(x=0.0, turn=0.0, color=NOISE, fixed=False, depth=None):
    c, s = np.cos(turn), np.sin(turn)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, 0, 1.0]))
    return View(0, Intrinsics(160, 120, 100.0, 100.0, 79.5, 59.5), T, color, depth,
                fixed=fixed)


def reason_of(gate, view):
    try:
        gate.check(view)
    except ViewError as error:
        return error.reason
    return ""


def test_blur_is_the_variance_of_the_laplacian():
    for sigma in (0.5, 5.0, 20.0):
        color = cv2.GaussianBlur(NOISE, (0, 0), sigma)
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        sharpness = cv2.Laplacian(grey, cv2.CV_64F).var()
        expected = "blurred" if sharpness < CONFIG.min_sharpness else ""
        assert reason_of(ViewGate(CONFIG), view(color=color)) == expected


@pytest.mark.parametrize("x, turn, reason", [
    (0.009, 0.0, "duplicate"), (0.011, 0.0, ""), (0.0, 0.04, "duplicate"), (0.0, 0.06, "")])
def test_a_moving_camera_must_have_moved_or_turned(x, turn, reason):
    gate = ViewGate(CONFIG)
    assert reason_of(gate, view()) == ""
    assert reason_of(gate, view(x, turn)) == reason


def test_steps_that_were_refused_add_up():
    gate = ViewGate(CONFIG)
    assert [reason_of(gate, view(x)) for x in (0.0, 0.006, 0.012, 0.018)] == [
        "", "duplicate", "", "duplicate"]


@pytest.mark.parametrize("fixed, x", [(True, 1.0), (False, 0.0), (False, 0.0005)])
@pytest.mark.parametrize("mode", ["scan", "continuous"])
@pytest.mark.parametrize("grey_levels, reason", [(3, "duplicate"), (10, "")])
def test_where_the_pose_has_not_changed_some_place_of_the_picture_must(
        grey_levels, reason, mode, fixed, x):
    changed = SMOOTH.copy()
    changed[60:70, 80:90] = np.clip(changed[60:70, 80:90].astype(int) + grey_levels, 0, 255)
    gate = ViewGate(replace(CONFIG, mode=mode))
    assert reason_of(gate, view(color=SMOOTH, fixed=fixed)) == ""
    assert reason_of(gate, view(x, color=changed, fixed=fixed)) == reason


def test_a_camera_that_stands_sees_part_after_part_taken():
    """Also one whose pose comes with every image; what it has seen once is a duplicate."""
    gate, pictures = ViewGate(CONFIG), []
    for i in range(5):
        color = SMOOTH.copy()
        color[20:30, 20:20 + 20 * i] //= 2
        pictures += [color, color]
    assert [reason_of(gate, view(color=color)) for color in pictures] == ["", "duplicate"] * 5


@pytest.mark.parametrize("mode, reason", [("scan", "duplicate"), ("continuous", "")])
def test_on_its_way_a_camera_of_a_scan_must_move_on(mode, reason):
    """A changed picture 5 mm away: new where the scan never ends, else too near the last view."""
    changed = SMOOTH.copy()
    changed[40:80, 60:100] = 255 - changed[40:80, 60:100]
    gate = ViewGate(replace(CONFIG, mode=mode))
    gate.check(view(color=SMOOTH))
    assert reason_of(gate, view(0.005, color=changed)) == reason


@pytest.mark.parametrize("shift_px", [0, 1, 2])
def test_noise_exposure_and_the_motion_itself_are_no_change(shift_px):
    """A shift of 1 pixel is a motion of 5 mm seen from 0.5 m."""
    gate, noise = ViewGate(replace(CONFIG, mode="continuous")), np.random.default_rng(1)
    gate.check(view(color=SMOOTH, depth=FLAT))
    for brightness in (1.0, 0.8, 1.2):
        color = brightness * np.roll(SMOOTH, shift_px, axis=1) + noise.normal(0, 4, SMOOTH.shape)
        depth = FLAT + noise.normal(0, 0.001, FLAT.shape).astype(np.float32)
        assert reason_of(gate, view(0.004 * shift_px, color=np.clip(color, 0, 255).astype(
            np.uint8), depth=depth)) == "duplicate"


@pytest.mark.parametrize("fixed", [False, True])
@pytest.mark.parametrize("metres, reason", [(0.002, "duplicate"), (0.02, ""), (-0.02, "")])
def test_depth_decides_where_the_picture_shows_no_change(metres, reason, fixed):
    """A part of the colour of those below it, 10 mm high, is taken or put there."""
    gate, changed = ViewGate(CONFIG), FLAT.copy()
    changed[60:66, 80:86] += metres
    assert reason_of(gate, view(depth=FLAT, fixed=fixed)) == ""
    assert reason_of(gate, view(depth=changed, fixed=fixed)) == reason


def test_holes_of_the_depth_are_no_change():
    gate, holes = ViewGate(CONFIG), FLAT.copy()
    holes[50:90, 50:90] = 0
    gate.check(view(depth=FLAT))
    assert [reason_of(gate, view(depth=depth)) for depth in (holes, FLAT, np.zeros_like(FLAT))] \
        == ["duplicate"] * 3


def test_a_duplicate_says_what_was_seen_and_expected():
    gate = ViewGate(CONFIG)
    gate.check(view(depth=FLAT))
    with pytest.raises(ViewError) as caught:
        gate.check(view(0.001, depth=FLAT))
    text = str(caught.value)
    assert "0.0010 m" in text and "expected 0.01 or 0.05" in text and "of 8.0 grey levels" in text


def test_in_cycle_mode_every_view_is_new():
    gate = ViewGate(replace(CONFIG, min_change=0.0, min_motion_m=0.0, min_motion_rad=0.0))
    assert [reason_of(gate, view(fixed=fixed)) for fixed in (False, False, True)] == [""] * 3


def test_other_limits_hold_from_the_next_view_on():
    gate = ViewGate(CONFIG)
    gate.check(view())
    gate.apply_limits(replace(CONFIG, min_motion_m=0.001))
    assert reason_of(gate, view(0.002)) == ""
