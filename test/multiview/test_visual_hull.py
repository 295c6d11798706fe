# SPDX-License-Identifier: Apache-2.0
"""Carving by labels alone, against closed forms."""

import numpy as np
import pytest
from kits.analytic import CAMERA, Scene

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.multiview.visual_hull import carve_visual_hull
from stack_counter.types import UNSEEN, View


def outlines(solid, poses, parts=2):
    """Label views: parts where a ray meets the solid."""
    views = []
    for i, T in enumerate(poses):
        depth = solid.view(T).depth
        views.append(View(i, CAMERA, T, labels=np.where(depth > 0, parts, 0).astype(np.uint8)))
    return views


def around(count=40, radius=0.6, center=(0.1, -0.05, 0.2)):
    """Poses all over a sphere."""
    i = np.arange(count) + 0.5
    polar, turn = np.arccos(1 - 2 * i / count), np.pi * (1 + 5**0.5) * i
    directions = np.stack([np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar),
                           np.cos(polar)], axis=1)
    return [geometry.look_at(np.array(center) + radius * d, np.array(center)) for d in directions]


def ball():
    return Scene(plane=False).sphere((0.1, -0.05, 0.2), 0.08)


TRUE = 4 / 3 * np.pi * 0.08**3


def test_ball_is_right_and_better_with_finer_voxels():
    views = outlines(ball(), around())
    coarse, fine = carve_visual_hull(views, 0.008, 0.5), carve_visual_hull(views, 0.002, 0.5)
    assert fine.volume == pytest.approx(TRUE, rel=0.04)  # a hull of 40 views holds a bit more
    assert abs(fine.volume - TRUE) <= abs(coarse.volume - TRUE) + 0.01 * TRUE
    assert fine.middle == pytest.approx([0.1, -0.05, 0.2], abs=0.001)
    distance = np.linalg.norm(fine.surface - [0.1, -0.05, 0.2], axis=1)
    assert np.median(distance) == pytest.approx(0.08, abs=0.003)


def test_space_outside_an_image_is_not_carved():
    views = outlines(ball(), around())
    blind = [View(v.stamp_ns, v.intrinsics, v.T_world_camera,
                  labels=np.where(np.arange(640) < 320, UNSEEN, v.labels).astype(np.uint8))
             for v in views[:5]]
    assert carve_visual_hull(views + blind, 0.004, 0.5).volume == pytest.approx(
        carve_visual_hull(views, 0.004, 0.5).volume, rel=0.01)


def test_one_view_that_says_background_carves():
    views = outlines(ball(), around())
    liar = View(99, CAMERA, views[0].T_world_camera, labels=np.zeros((480, 640), np.uint8))
    with pytest.raises(ScanError, match="0 voxels left"):
        carve_visual_hull([*views, liar], 0.004, 0.5)


def test_where_two_must_say_so_one_does_not_carve():
    views = outlines(ball(), around())
    liar = View(99, CAMERA, views[0].T_world_camera, labels=np.zeros((480, 640), np.uint8))
    assert carve_visual_hull([*views, liar], 0.004, 0.5, votes=2).volume == pytest.approx(
        TRUE, rel=0.15
    )
    with pytest.raises(ScanError, match="0 voxels left"):
        carve_visual_hull([*views, liar, liar], 0.004, 0.5, votes=2)


def test_background_only_and_parallel_views_are_refused():
    views = outlines(ball(), around(6), parts=0)
    with pytest.raises(ScanError, match="all 6 label images are background"):
        carve_visual_hull(views, 0.004, 0.5)
    one = around(1)[0]
    with pytest.raises(ScanError, match="several sides"):
        carve_visual_hull(outlines(ball(), [one, one, one]), 0.004, 0.5)
