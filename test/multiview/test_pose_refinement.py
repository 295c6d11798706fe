# SPDX-License-Identifier: Apache-2.0
"""Poses that pictures correct, against poses that are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.multiview.pose_refinement import essential_matrices, refine_poses
from stack_counter.types import Intrinsics

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
POINTS = np.array([[x, y, z] for x in (-0.1, 0.1) for y in (-0.08, 0.08) for z in (0, 0.08)])


def scan(count=8):
    """Views of a box on the plane, both covered with spots of 12 mm, at true poses."""
    random = np.random.default_rng(1)
    spots = cv2.GaussianBlur(random.uniform(0, 255, (400, 400)).astype(np.float32), (0, 0), 2.5)
    spots = np.clip(127 + 6 * (spots - spots.mean()), 0, 255)
    box = Scene().box(np.array([0, 0, 0.04]), np.array([0.16, 0.12, 0.08]))
    views = []
    for view in box.views(count, 0.5, (0, 0, 0.04), camera=CAMERA):
        points = geometry.world_points(view)
        cells = np.clip((points[..., :2] + 0.02 * points[..., 2:] + 0.5) / 0.0025, 0, 399)
        grey = cv2.remap(spots, cells[..., 0], cells[..., 1], cv2.INTER_LINEAR)
        color = np.repeat(grey[..., None], 3, axis=-1).astype(np.uint8)
        views.append(replace(view, color=color))
    return views


def shaken(views, seed=0):
    """The views at poses with the errors of a robot: 0.05 degrees and half a millimetre."""
    random = np.random.default_rng(seed)
    out = []
    for view in views:
        turn = cv2.Rodrigues(np.deg2rad(0.05) * random.normal(size=3))[0]
        error = geometry.pose(turn, random.normal(0, 0.0005, 3))
        out.append(replace(view, T_world_camera=view.T_world_camera @ error))
    return out


def shifts(views, true):
    """How far each view shows the box's corners from where the true one does, without what is
    common to all, pixels."""
    off = np.array([geometry.project(geometry.apply(geometry.inverse(view.T_world_camera), POINTS),
                                     CAMERA)[0]
                    - geometry.project(geometry.apply(geometry.inverse(ideal.T_world_camera),
                                                      POINTS), CAMERA)[0]
                    for view, ideal in zip(views, true)])
    return float(np.sqrt((off**2).mean()))


def test_poses_come_nearer_to_the_true_ones():
    true = scan()
    reported = shaken(true)
    refined = refine_poses(reported)
    assert shifts(refined, true) < 0.6 * shifts(reported, true)
    for view, before in zip(refined, reported):
        assert np.array_equal(view.color, before.color)
        R = view.T_world_camera[:3, :3]
        assert R @ R.T == pytest.approx(np.eye(3), abs=1e-9)


def test_true_poses_stay():
    true = scan()
    assert shifts(refine_poses(true), true) < 0.1


def test_without_texture_the_reported_poses_hold():
    blank = [replace(view, color=np.full_like(view.color, 90)) for view in shaken(scan(4))]
    for view, before in zip(refine_poses(blank), blank):
        assert np.array_equal(view.T_world_camera, before.T_world_camera)


def test_pictures_of_one_place_have_no_epipolar_lines():
    view = scan(1)[0]
    assert refine_poses([view, view])[1].T_world_camera == pytest.approx(view.T_world_camera)


def test_rays_to_one_point_are_on_each_others_lines():
    a, b = scan(2)
    point = np.array([0.03, -0.02, 0.05])
    ray_a, ray_b = (geometry.apply(geometry.inverse(v.T_world_camera), point) for v in (a, b))
    E = essential_matrices(a.T_world_camera, b.T_world_camera)
    assert ray_b @ E @ ray_a == pytest.approx(0, abs=1e-12)
    assert abs((ray_b + [0.01, 0.01, 0]) @ E @ ray_a) > 1e-4


def test_pictures_are_needed():
    with pytest.raises(ViewError, match="no_color"):
        refine_poses([replace(view, color=None) for view in scan(2)])
