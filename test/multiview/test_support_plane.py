# SPDX-License-Identifier: Apache-2.0
"""Which way is up, and the support that background shows, against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview.support_plane import fill_support_depth, find_upright
from stack_counter.types import BACKGROUND, PARTS, UNSEEN, Intrinsics

CAMERA = Intrinsics(160, 120, 150.0, 150.0, 79.5, 59.5)
# Any frame: turned about all axes, and shifted.
T_OTHER = geometry.pose_from_quaternion(np.array([0.2, -0.4, 0.5, np.sqrt(0.55)]),
                                        np.array([1.0, -2, 0.5]))


def scan(world=np.eye(4), height=0.3):
    """Views, in another world, of a box on the plane z = `height` of this one."""
    lifted = world @ geometry.pose(np.eye(3), np.array([0, 0, height]))
    views = []
    for view in Scene().box(np.array([0, 0, 0.04]), np.array([0.16, 0.12, 0.08])).views(
            6, camera=CAMERA):
        above = geometry.world_points(view)[..., 2] > 1e-4
        labels = np.where(above, PARTS, BACKGROUND).astype(np.uint8)
        views.append(replace(view, labels=labels, T_world_camera=lifted @ view.T_world_camera))
    return views


def test_up_and_the_height_are_found_from_the_support():
    T, plane_z = find_upright(scan(T_OTHER))
    there = T @ T_OTHER  # upright world of the box -> what was found
    assert there[:3, 2] == pytest.approx([0, 0, 1], abs=1e-3)
    assert geometry.apply(there, np.array([0, 0, 0.3]))[2] == pytest.approx(plane_z, abs=1e-3)
    assert T[:3, :3] @ T[:3, :3].T == pytest.approx(np.eye(3), abs=1e-9)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1)


def test_a_world_with_z_up_is_not_turned():
    T, plane_z = find_upright(scan())
    assert np.array_equal(T, np.eye(4))
    assert plane_z == pytest.approx(0.3, abs=5e-4)


def test_background_shows_the_support_and_nothing_else_changes():
    view = scan()[0]
    ideal = view.depth.copy()
    labels = view.labels.copy()
    labels[:5] = UNSEEN
    holes = np.where(labels == BACKGROUND, 0, ideal).astype(np.float32)
    shown = fill_support_depth(replace(view, depth=holes, labels=labels), 0.3)
    ground = labels == BACKGROUND
    assert shown.depth[ground] == pytest.approx(ideal[ground], abs=1e-5)
    assert np.array_equal(shown.depth[~ground], holes[~ground])


def test_above_the_horizon_there_is_no_support():
    view = scan()[0]
    level = geometry.look_at(np.array([0, 0, 0.6]), np.array([1.0, 0, 0.6]))
    blank = np.zeros_like(view.depth)
    view = replace(view, T_world_camera=level, depth=blank, labels=blank.astype(np.uint8))
    shown = fill_support_depth(view, 0.3).depth
    assert not shown[:59].any() and np.all(shown[61:] > 0)


def test_no_level_support_is_said():
    random = np.random.default_rng(0)
    rough = [replace(view, depth=(view.depth * random.uniform(0.5, 1.5, view.depth.shape)).astype(
        np.float32)) for view in scan()]
    with pytest.raises(ScanError, match="no level support"):
        find_upright(rough)
    with pytest.raises(ScanError, match="0 points of background"):
        find_upright([replace(view, depth=np.zeros_like(view.depth)) for view in scan()])
    with pytest.raises(ViewError, match="no_depth"):
        find_upright([replace(scan()[0], depth=None)])
    with pytest.raises(ViewError, match="no_depth"):
        fill_support_depth(replace(scan()[0], depth=None), 0.0)
