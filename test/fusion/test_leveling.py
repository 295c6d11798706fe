# SPDX-License-Identifier: Apache-2.0
"""Poses corrected by the support plane that their own pictures show."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.fusion.leveling import level_to_support
from stack_counter.fusion.region import Region

REGION = Region(np.array([-0.1, -0.1, -0.02]), np.array([0.1, 0.1, 0.3]), 0.0, 0.001)


def view(height=0.06, size=0.12):
    scene = Scene().box([0.0, 0.0, height / 2], [size, size, height])
    return scene.view(geometry.look_at(np.array([0.25, 0.1, 0.7]), np.zeros(3)))


def off(view, degrees, metres):
    """The view with a reported pose that is rolled, pitched and lifted."""
    a, b = np.deg2rad(degrees)
    turn = np.array([[1, 0, b], [0, 1, -a], [-b, a, 1]])
    wrong = geometry.pose(np.linalg.qr(turn)[0] * np.sign(np.diag(np.linalg.qr(turn)[1])),
                          np.array([0, 0, metres]))
    return replace(view, T_world_camera=wrong @ view.T_world_camera)


@pytest.mark.parametrize("degrees, metres", [((0, 0), 0.004), ((0.4, 0), 0),
                                             ((-0.2, 0.3), -0.003)])
def test_height_roll_and_pitch_are_corrected(degrees, metres):
    right = view()
    got = level_to_support(off(right, degrees, metres), REGION)
    miss = got.T_world_camera @ geometry.inverse(right.T_world_camera)
    plane = geometry.apply(miss, np.array([[-0.1, -0.1, 0], [0.1, 0, 0], [0, 0.1, 0]]))
    assert np.abs(plane[:, 2]).max() < 4e-4
    np.testing.assert_allclose(got.T_world_camera[:2, 3], right.T_world_camera[:2, 3], atol=0.006)


def test_a_right_pose_stays():
    right = view()
    np.testing.assert_allclose(
        level_to_support(right, REGION).T_world_camera, right.T_world_camera, atol=5e-4
    )


@pytest.mark.filterwarnings("error")
def test_depth_without_any_noise_is_levelled_too():
    above = geometry.pose(np.diag([1.0, -1, -1]), np.array([0, 0, 0.75]))
    exact = Scene().box([0, 0, 0.03], [0.12, 0.12, 0.06]).view(above)
    np.testing.assert_allclose(level_to_support(exact, REGION).T_world_camera, above, atol=5e-4)


def test_the_floor_of_an_empty_bin_is_not_the_support():
    low = view(height=0.004)  # as level as the support, and much larger than what shows of it
    np.testing.assert_allclose(
        level_to_support(low, REGION).T_world_camera, low.T_world_camera, atol=5e-4
    )


@pytest.mark.parametrize("wrong", [off(view(), (0, 0), 0.02), off(view(), (3, 0), 0.0),
                                   view(0.06, 0.5)])
def test_a_plane_too_far_off_or_hardly_seen_says_nothing(wrong):
    assert level_to_support(wrong, REGION) is wrong


def test_around_a_configured_region_the_plane_beyond_it_counts():
    """A region cut tightly around a bin in a row: its neighbours' floors are level too."""
    scene = Scene()
    for x in (-0.12, 0.0, 0.12):
        scene.bin((0.1, 0.16, 0.06), 0.004, 0.004, 0.0, x)
    region = replace(REGION, low=np.array([-0.058, -0.088, -0.04]),
                     high=np.array([0.058, 0.088, 0.1]), noise=0.0005, configured=True)
    for view in scene.views(3, noise=0.0005):
        level = level_to_support(off(view, (0.2, -0.1), 0.002), region)
        moved = level.T_world_camera @ geometry.inverse(view.T_world_camera)
        assert np.abs(moved[2, [0, 1]]).max() < 4e-4  # rad
        assert abs(moved[2, 3]) < 2e-4
