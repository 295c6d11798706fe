# SPDX-License-Identifier: Apache-2.0
"""Carving by labels and depth against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview import visual_hull
from stack_counter.multiview.closed_container import carve_closed_container
from stack_counter.types import PARTS, Intrinsics

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
SIZE = (0.16, 0.12, 0.08)
VOLUME = float(np.prod(SIZE))


def scan(count=12, tilt_deg=50):
    """Views of a box on the plane with ideal depth and labels, in sight of its sides."""
    box = Scene().box(np.array([0, 0, SIZE[2] / 2]), np.array(SIZE))
    views = []
    for i in range(count):
        turn, tilt = 2 * np.pi * i / count, np.deg2rad(tilt_deg - 20 * (i % 2))
        away = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        T = geometry.look_at(np.array([0, 0, 0.04]) + 0.5 * away, np.array([0, 0, 0.03]))
        view = box.view(T, CAMERA, i)
        points = geometry.apply(T, geometry.unproject(view.depth, CAMERA).astype(float))
        labels = np.where(points[..., 2] > 1e-4, PARTS, 0).astype(np.uint8)
        views.append(replace(view, labels=labels, T_world_camera=T))
    return views


@pytest.fixture(scope="module")
def box():
    views = scan()
    return views, visual_hull.carve_visual_hull(views, 0.006, 0.5)


def test_depth_takes_away_what_the_outline_leaves(box):
    views, carved = box
    found = carve_closed_container(views, carved, 0.002, 0.0)
    assert found.outline_volume > 1.15 * VOLUME  # views from above leave a roof
    assert found.volume == pytest.approx(VOLUME, rel=0.03)
    assert abs(found.volume - VOLUME) < 2 * found.volume_std
    assert found.measured_share > 0.9
    top = found.surface[np.abs(found.surface[:, :2]).max(axis=1) < 0.04]
    assert np.median(top[:, 2]) == pytest.approx(SIZE[2], abs=0.002)


@pytest.mark.parametrize("side", [0.008, 0.004, 0.002])
def test_the_error_is_a_part_of_a_voxel(box, side):
    views, carved = box
    area = 2 * (SIZE[0] + SIZE[1]) * SIZE[2] + SIZE[0] * SIZE[1]
    assert carve_closed_container(views, carved, side, 0.0).volume == pytest.approx(
        VOLUME, abs=side / 4 * area
    )


def test_without_depth_the_outline_stands(box):
    views, carved = box
    blind = [replace(view, depth=np.zeros_like(view.depth)) for view in views]
    found = carve_closed_container(blind, carved, 0.003, 0.0)
    assert found.volume == found.outline_volume
    assert found.measured_share == 0
    assert found.volume_std > 3 * carve_closed_container(views, carved, 0.003, 0.0).volume_std


def test_one_wrong_depth_does_not_carve(box):
    views, carved = box
    one = [replace(view, depth=view.depth + 0.05 if i == 0 else np.zeros_like(view.depth))
           for i, view in enumerate(views)]
    found = carve_closed_container(one, carved, 0.003, 0.0)
    assert found.volume == found.outline_volume


def test_the_top_is_the_roof_of_the_box(box):
    views, carved = box
    top = carve_closed_container(views, carved, 0.002, 0.0).top
    points = top.T_world_map[:2, 3] + (np.argwhere(np.isfinite(top.heights))[:, ::-1]
                                       + 0.5) * top.pitch
    assert np.ptp(points, axis=0) == pytest.approx(SIZE[:2], abs=0.007)
    assert np.nanmedian(top.heights) == pytest.approx(SIZE[2], abs=0.002)
    assert top.T_world_map[2, 3] == 0


def test_the_volume_stands_on_the_support(box):
    views, carved = box
    whole = carve_closed_container(views, carved, 0.002, 0.0)
    upper = carve_closed_container(views, carved, 0.002, 0.04)
    assert upper.volume == pytest.approx(whole.volume / 2, rel=0.05)
    assert np.nanmedian(upper.top.heights) == pytest.approx(SIZE[2] - 0.04, abs=0.002)


def test_what_is_missing_is_named(box):
    views, carved = box
    with pytest.raises(ViewError, match="no_depth"):
        carve_closed_container([replace(view, depth=None) for view in views], carved, 0.003, 0.0)
    with pytest.raises(ViewError, match="no_labels"):
        carve_closed_container([replace(view, labels=None) for view in views], carved, 0.003, 0.0)
    with pytest.raises(ScanError, match="below the support"):
        carve_closed_container(views, carved, 0.003, 1.0)
    with pytest.raises(ScanError, match="surface has 0 voxels"):
        carve_closed_container(views, replace(carved, surface=carved.surface[:0]), 0.003, 0.0)
