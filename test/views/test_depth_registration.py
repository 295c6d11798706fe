# SPDX-License-Identifier: Apache-2.0
"""Registered depth against what the other camera sees in closed form."""

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.types import Intrinsics
from stack_counter.views.depth_registration import register_depth

COLOR = Intrinsics(160, 120, 152.0, 152.0, 79.5, 59.5)
COARSE = Intrinsics(120, 90, 80.0, 81.0, 60.0, 44.0)
FINE = Intrinsics(320, 240, 250.0, 250.0, 159.5, 119.5)
ABOVE = geometry.look_at(np.array([0.05, 0.02, 0.5]), np.zeros(3))
T = geometry.pose(np.eye(3), np.array([0.02, 0.0, 0.003]))


def registered(scene, camera, T_color_depth=T, **options):
    depth = scene.view(ABOVE @ T_color_depth, camera, **options).depth
    return register_depth(depth, camera, COLOR, T_color_depth)


def test_the_same_camera_changes_nothing():
    depth = Scene().sphere((0, 0, 0.05), 0.05).view(ABOVE, COLOR).depth
    np.testing.assert_allclose(register_depth(depth, COLOR, COLOR, np.eye(4)), depth, atol=1e-6)
    assert not register_depth(np.zeros_like(depth), COLOR, COLOR, np.eye(4)).any()


@pytest.mark.parametrize("camera", [COARSE, FINE], ids=["coarse", "fine"])
def test_a_plane_is_where_the_other_camera_sees_it(camera):
    truth = Scene().view(ABOVE, COLOR).depth[10:-10, 10:-10]
    found = registered(Scene(), camera)[10:-10, 10:-10]
    assert (found > 0).mean() > 0.999  # a finer image has no holes
    # Half a depth pixel beside its place, an oblique plane is this far off at most.
    error = (found - truth)[found > 0]
    slope = np.abs(np.diff(truth, axis=1)).max() + np.abs(np.diff(truth, axis=0)).max()
    assert np.abs(error).max() < slope * COLOR.fx / camera.fx
    assert abs(error.mean()) < 1e-4


@pytest.mark.parametrize("camera", [COARSE, FINE], ids=["coarse", "fine"])
def test_what_lies_behind_does_not_show_through_what_lies_in_front(camera):
    scene = Scene().box((0, 0, 0.15), (0.12, 0.10, 0.02))
    near = scene.view(ABOVE, COLOR).depth < 0.4
    inner = np.lib.stride_tricks.sliding_window_view(np.pad(near, 2), (5, 5)).all(axis=(2, 3))
    found = registered(scene, camera)[inner]
    assert inner.sum() > 500 and (found > 0).mean() > 0.999
    assert found.max() < 0.4


def test_noise_is_averaged_where_several_pixels_fall_into_one():
    """The nearest of them alone would lie a sigma too near."""
    scene, sigma = Scene(), 0.0015
    error = registered(scene, FINE, noise=sigma) - scene.view(ABOVE, COLOR).depth
    error = error[10:-10, 10:-10]
    assert abs(error.mean()) < sigma / 10 and error.std() < sigma


def test_points_behind_the_camera_and_beside_its_image_are_left_out():
    back = geometry.pose(np.diag([-1.0, 1, -1]), np.zeros(3))
    assert not registered(Scene(), COARSE, back).any()
    aside = geometry.pose(np.eye(3), np.array([2.0, 0, 0]))
    depth = np.full((COARSE.height, COARSE.width), 0.5, np.float32)
    assert not register_depth(depth, COARSE, COLOR, aside).any()
