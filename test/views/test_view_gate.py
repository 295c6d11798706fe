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


def view(x=0.0, turn=0.0, color=NOISE, fixed=False):
    c, s = np.cos(turn), np.sin(turn)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, 0, 1.0]))
    return View(0, Intrinsics(160, 120, 100.0, 100.0, 79.5, 59.5), T, color, fixed=fixed)


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


@pytest.mark.parametrize("grey_levels, reason", [(3, "duplicate"), (5, "")])
def test_a_fixed_camera_must_see_a_change_of_some_place(grey_levels, reason):
    flat = np.full((120, 160, 3), 100, np.uint8)
    flat[::8] = 200  # sharp
    changed = flat.copy()
    changed[60:70, 80:90] = np.clip(changed[60:70, 80:90].astype(int) + grey_levels, 0, 255)
    gate = ViewGate(CONFIG)
    assert reason_of(gate, view(color=flat, fixed=True)) == ""
    assert reason_of(gate, view(x=1.0, color=changed, fixed=True)) == reason


def test_other_limits_hold_from_the_next_view_on():
    gate = ViewGate(CONFIG)
    gate.check(view())
    gate.apply_limits(replace(CONFIG, min_motion_m=0.001))
    assert reason_of(gate, view(0.002)) == ""
