# SPDX-License-Identifier: Apache-2.0
"""Walls without texture are found by their outlines in label images."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.rim import Rim
from stack_counter.container.silhouettes import Silhouettes, WallOutlines
from stack_counter.container.wall_fit import FacePoints, Thickness, fit_wall
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.container.wall_thickness import SETTINGS, expected_thickness
from stack_counter.fusion.region import Region
from stack_counter.types import CONTAINER, Intrinsics, View

HEIGHT, PLANE_Z = 0.12, 0.03
CAMERA = Intrinsics(640, 480, 610.0, 610.0, 319.5, 239.5)
TRUE = {"box": BoxWall(np.array([0.02, -0.03, 0.3, 0.2, 0.15, 0.15])),
        "round": RoundWall(np.array([0.02, -0.03, 0.09, 0.2, 0.0]))}
NOTHING = FacePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool))


def outline_views(shape, count=16, tilt_deg=40):
    """Views from all around whose labels show a closed solid between rim and foot."""
    corners = np.concatenate([np.column_stack([ring := shape.ring(below, 0.0), np.full(
        len(ring), PLANE_Z + HEIGHT - below)]) for below in (0.0, HEIGHT)])
    views = []
    for angle in 2 * np.pi * np.arange(count) / count:
        tilt = np.deg2rad(tilt_deg)
        away = np.array([np.sin(tilt) * np.cos(angle), np.sin(tilt) * np.sin(angle),
                         np.cos(tilt)])
        target = np.array([*shape.center, PLANE_Z + HEIGHT / 2])
        right = np.cross([0.0, 0.0, 1.0], away)
        right /= np.linalg.norm(right)
        T = geometry.pose(np.stack([right, -np.cross(away, right), -away], axis=1),
                          target + 0.6 * away)
        pixels, _ = geometry.project(geometry.apply(geometry.inverse(T), corners), CAMERA)
        labels = np.zeros((CAMERA.height, CAMERA.width), np.uint8)
        hull = cv2.convexHull(pixels.astype(np.float32))
        cv2.fillConvexPoly(labels, np.round(hull * 16).astype(np.int32), CONTAINER, shift=4)
        views.append(View(1, CAMERA, T, labels=labels))
    return views


def test_points_lie_as_far_inside_as_the_narrowest_outline_says():
    views = outline_views(TRUE["round"])
    middle = np.array([[*TRUE["round"].center, PLANE_Z + HEIGHT / 2]])
    beside = middle + [[0.15, 0, 0]]
    behind = middle + [[0, 0, 5.0]]  # the cameras stand below it
    inside = Silhouettes(views).depth_inside(np.concatenate([middle, beside, behind]))
    assert 0.04 < inside[0] < 0.09 and inside[1] < -0.04 and np.isinf(inside[2])


@pytest.mark.parametrize("kind", TRUE)
def test_the_foot_gives_the_draft_where_nothing_of_the_wall_was_measured(kind):
    true = TRUE[kind]
    guess = true.with_params(np.where(np.arange(len(true.params)) < (5 if kind == "box" else 3),
                                      true.params, 0.0))
    outlines = WallOutlines.of_views(outline_views(true), guess, HEIGHT, PLANE_Z)
    wall = fit_wall(guess, NOTHING, HEIGHT, Thickness(0.005, 0.001), 0.001, outlines)
    for below in (0.0, HEIGHT / 2, HEIGHT):
        width, expected = (np.ptp(shape.ring(below, 0.0), axis=0) for shape in (wall.shape, true))
        assert width == pytest.approx(expected, abs=0.003), below
    # Without outlines it would stand upright.
    upright = fit_wall(guess, NOTHING, HEIGHT, Thickness(0.005, 0.001), 0.001)
    assert np.ptp(upright.shape.ring(HEIGHT, 0.0)[:, 0]) > np.ptp(
        true.ring(HEIGHT, 0.0)[:, 0]) + 0.02


def test_stereo_takes_parts_for_an_inner_face_which_then_counts_nothing():
    true = TRUE["round"]
    random = np.random.default_rng(0)
    below, angle = random.uniform(0.003, HEIGHT, 20_000), random.uniform(0, 2 * np.pi, 20_000)
    # Points that come in far faster than the wall does.
    radius = true.params[2] - 0.002 - 0.6 * below
    xy = true.center + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    parts = FacePoints(xy, below, np.ones(len(below), bool))
    outlines = WallOutlines.of_views(outline_views(true), true, HEIGHT, PLANE_Z)
    with_outlines, without = (fit_wall(true, parts, HEIGHT, Thickness(0.003, 0.001), 0.001, o)
                              for o in (outlines, None))
    foot = [np.ptp(wall.shape.ring(HEIGHT, 0.0)[:, 0]) for wall in (with_outlines, without)]
    assert foot[0] == pytest.approx(np.ptp(true.ring(HEIGHT, 0.0)[:, 0]), abs=0.003)
    assert foot[1] < foot[0] - 0.02


def test_stereo_makes_rims_wider():
    rim = Rim(TRUE["round"], HEIGHT, 1.0, 1.0, 0.006)
    region = Region(-np.ones(3), np.ones(3), PLANE_Z, 0.001)
    views, config = outline_views(TRUE["round"]), ReconstructorConfig()
    stereo = replace(region, stereo_window_m=0.004)
    by_depth, by_stereo = (expected_thickness(rim, views, r, config) for r in (region, stereo))
    assert by_depth.mean == 0.006
    assert by_stereo.mean == pytest.approx(0.006 - 0.004 * SETTINGS.stereo_rim_windows)
    thin = expected_thickness(replace(rim, width=0.001), views, stereo, config)
    assert thin.mean == SETTINGS.thinnest
    given = replace(config, container_wall_m=0.006)
    assert expected_thickness(rim, views, stereo, given).mean == 0.006
