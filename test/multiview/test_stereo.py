# SPDX-License-Identifier: Apache-2.0
"""Depth from pictures against closed forms: a solid whose texture is a function of space."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene
from kits.textures import wavy_texture

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview import visual_hull
from stack_counter.multiview.plane_sweep import (
    WORST,
    Picture,
    aggregate_paths,
    find_best_planes,
    sweep_planes,
)
from stack_counter.multiview.scan import scale_down
from stack_counter.multiview.search_bounds import hull_bounds
from stack_counter.multiview.stereo import (
    StereoSettings,
    choose_neighbours,
    depth_from_pictures,
)
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Intrinsics, View

CAMERA = Intrinsics(200, 150, 190.0, 190.0, 99.5, 74.5)
SIZE = np.array([0.16, 0.12, 0.08])


def poses(count=12, distance=0.5):
    """A ring of cameras around the box, in two heights."""
    out = []
    for i in range(count):
        turn, tilt = 2 * np.pi * i / count, np.deg2rad((25, 40)[i % 2])
        away = np.array([np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)])
        out.append(geometry.look_at(np.array([0, 0, 0.04]) + distance * away,
                                    np.array([0, 0, 0.03])))
    return out


def scan(texture=wavy_texture):
    """Colour views with labels, and their true depths (n, h, w)."""
    box = Scene().box(np.array([0, 0, SIZE[2] / 2]), SIZE)
    views, truth = [], []
    for i, T in enumerate(poses()):
        seen = box.view(T, CAMERA, i)
        points = geometry.world_points(seen)
        labels = np.where(points[..., 2] > 1e-4, PARTS, BACKGROUND).astype(np.uint8)
        color = np.repeat(texture(points)[..., None], 3, axis=-1).astype(np.uint8)
        views.append(replace(seen, depth=None, color=color, labels=labels))
        truth.append(seen.depth)
    return views, np.array(truth)


@pytest.fixture(scope="module")
def box():
    """Views, true depths, hull and the views with depth."""
    views, truth = scan()
    carved = visual_hull.carve_visual_hull(views, 0.008, 0.5)
    return views, truth, carved, depth_from_pictures(views, carved)


def test_a_textured_box_and_its_support_are_right_to_one_percent(box):
    _, truth, _, found = box
    # The ring is part of the background. At 2.6 mm a pixel, borders take in both sides.
    for label, least, right in ((PARTS, 0.8, 0.92), (BACKGROUND, 0.02, 0.97)):
        known, close, seen = 0, 0, 0
        for view, ideal in zip(found, truth):
            here = view.labels == label
            seen += np.count_nonzero(here)
            known += np.count_nonzero(here & (view.depth > 0))
            close += np.count_nonzero(here & (np.abs(view.depth / ideal - 1) < 0.01))
        assert known > least * seen
        assert close > right * known


def test_depth_is_unbiased_between_planes(box):
    _, truth, _, found = box
    off = np.concatenate([(view.depth - ideal)[(view.depth > 0) & (view.labels == PARTS)]
                          for view, ideal in zip(found, truth)])
    assert abs(np.median(off)) < 0.0005
    assert np.median(np.abs(off)) < 0.0012


def test_views_are_kept_as_they_were(box):
    views, _, _, found = box
    for before, after in zip(views, found):
        assert after.depth.dtype == np.float32
        assert after.depth.shape == after.labels.shape == after.color.shape[:2]
        assert (after.stamp_ns, after.intrinsics) == (before.stamp_ns, before.intrinsics)


def test_half_the_resolution_keeps_calibration_and_scale():
    views, truth = scan()
    views = [scale_down(view, 2) for view in views]
    found = depth_from_pictures(views, visual_hull.carve_visual_hull(views, 0.008, 0.5))
    assert found[0].intrinsics.width == 100
    assert found[0].depth.shape == found[0].labels.shape == found[0].color.shape[:2] == (75, 100)
    off = np.concatenate([(view.depth - ideal[1::2, 1::2])[(view.depth > 0)
                                                           & (view.labels == PARTS)]
                          for view, ideal in zip(found, truth)])
    assert len(off) > 1000
    assert abs(np.median(off)) < 0.0015


def test_without_texture_nothing_is_known():
    views, _ = scan(lambda points: np.full(points.shape[:-1], 120, np.float32))
    found = depth_from_pictures(views, visual_hull.carve_visual_hull(views, 0.008, 0.5))
    assert all(not view.depth.any() for view in found)


def test_pictures_of_other_places_agree_on_little():
    views, _ = scan()
    colors = [view.color for view in views]
    # Labels and poses stay; every picture is that of another camera.
    mixed = [replace(view, color=colors[(5 * i + 3) % len(views)]) for i, view in enumerate(views)]
    found = depth_from_pictures(mixed, visual_hull.carve_visual_hull(views, 0.008, 0.5))
    known = np.mean([(view.depth[view.labels == PARTS] > 0).mean() for view in found])
    assert known < 0.08  # 0.86 with the right ones


def test_what_is_missing_is_named():
    views, _ = scan()
    carved = visual_hull.carve_visual_hull(views, 0.008, 0.5)
    with pytest.raises(ViewError, match="no_color: .*expects one") as caught:
        depth_from_pictures([replace(view, color=None) for view in views], carved)
    assert "\n" not in str(caught.value)
    with pytest.raises(ViewError, match="no_labels: .*expected one"):
        depth_from_pictures([replace(view, labels=None) for view in views], carved)
    with pytest.raises(ScanError, match="2 views; stereo expects at least 3"):
        depth_from_pictures(views[:2], carved)
    with pytest.raises(ScanError, match="surface has 0 voxels"):
        depth_from_pictures(views, replace(carved, surface=carved.surface[:0]))


def test_the_hull_bounds_the_true_depth(box):
    views, truth, carved, _ = box
    inside = []
    for view, ideal in zip(views, truth):
        near, far = hull_bounds(view, carved)
        parts = view.labels == PARTS
        inside.append(((near <= ideal) & (ideal <= far))[parts].mean())
    assert min(inside) > 0.99


def test_the_hull_is_only_where_it_projects(box):
    views, _, carved, _ = box
    away = replace(views[0], T_world_camera=geometry.look_at(np.array([0, 0, 1.0]),
                                                             np.array([0, 0, 2.0])))
    near, far = hull_bounds(away, carved)
    assert not near.any() and not far.any()


def test_parts_beside_a_rim_are_left_open():
    views, _ = scan()
    rimmed = []
    for view in views:
        labels = view.labels.copy()
        labels[:, 90:95] = np.where(labels[:, 90:95] == PARTS, CONTAINER, BACKGROUND)
        rimmed.append(replace(view, labels=labels))
    found = depth_from_pictures(rimmed, visual_hull.carve_visual_hull(views, 0.008, 0.5))
    beside = np.concatenate([v.depth[:, [88, 89, 95, 96]][v.labels[:, [88, 89, 95, 96]] == PARTS]
                             for v in found])
    on = np.concatenate([v.depth[:, 90:95][v.labels[:, 90:95] == CONTAINER] for v in found])
    assert len(beside) > 100 and not beside.any()
    assert (on > 0).mean() > 0.5


def test_neighbours_are_at_a_useful_angle_and_apart():
    degrees = np.array([0.0, 1, 8, 9, 15, 20, 28, 60])
    angles = np.deg2rad(np.abs(degrees[:, None] - degrees))
    config = StereoSettings(neighbours=4)
    chosen = choose_neighbours(angles, 0, config)
    assert sorted(chosen) == [3, 4, 5, 6]  # not both of 8 and 9 degrees
    assert sorted(choose_neighbours(angles, 0, replace(config, neighbours=9))) == [2, 3, 4, 5, 6]
    assert choose_neighbours(angles, 7, config) == [6, 5]  # none within 30 degrees: the nearest


def picture(T, depth):
    """A picture of the textured plane z = `depth` in front of the identity pose."""
    v, u = np.mgrid[:60, :80]
    ray = np.stack([(u - 39.5) / 100, (v - 29.5) / 100, np.ones(u.shape)], -1) @ T[:3, :3].T
    points = T[:3, 3] + ray * ((depth - T[2, 3]) / ray[..., 2])[..., None]
    K = np.array([[100.0, 0, 39.5], [0, 100, 29.5], [0, 0, 1]])
    return Picture(wavy_texture(points.astype(np.float32)), K, T)


def test_the_right_plane_costs_least():
    reference = picture(np.eye(4), 0.5)
    moved = [picture(geometry.pose(np.eye(3), np.array([x, y, 0])), 0.5)
             for x, y in ((0.03, 0), (-0.03, 0.01), (0, 0.03))]
    planes = np.array([1 / 0.7, 1 / 0.6, 1 / 0.5, 1 / 0.4])
    cost = sweep_planes(reference, moved, planes, np.ones((4, 60, 80), bool), 2)
    middle = cost[:, 12:-12, 12:-12]
    assert np.all(np.argmin(middle, axis=0) == 2)
    assert middle[2].max() < 0.1 * WORST


def test_a_picture_of_something_else_is_outvoted():
    reference = picture(np.eye(4), 0.5)
    good = [picture(geometry.pose(np.eye(3), np.array([x, 0, 0])), 0.5) for x in (0.03, -0.03)]
    other = Picture(np.ascontiguousarray(good[0].grey[::-1, ::-1]), good[0].K,
                    good[0].T_world_camera)
    cost = sweep_planes(reference, [*good, other], np.array([2.0]), np.ones((1, 60, 80), bool), 2)
    assert cost[0, 12:-12, 12:-12].max() < 0.15 * WORST
    alone = sweep_planes(reference, [other], np.array([2.0]), np.ones((1, 60, 80), bool), 2)
    assert np.median(alone) > 0.5 * WORST


def test_only_allowed_pixels_are_looked_at_and_cost_the_same():
    reference = picture(np.eye(4), 0.5)
    moved = [picture(geometry.pose(np.eye(3), np.array([0.03, 0, 0])), 0.5)]
    everywhere = np.ones((2, 60, 80), bool)
    some = np.zeros_like(everywhere)
    some[0, 20:35, 0:30] = True
    planes = np.array([2.0, 1.5])
    cost = sweep_planes(reference, moved, planes, some, 2)
    assert np.all(cost[~some] == WORST)
    whole = sweep_planes(reference, moved, planes, everywhere, 2)
    assert np.abs(cost[some].astype(int) - whole[some]).max() <= 1


def test_equal_costs_stay_equal():
    cost = np.full((5, 7, 9), 30, np.uint8)
    assert np.all(aggregate_paths(cost, np.zeros((7, 9), np.float32), 10, 80) == 8 * 30)


def test_a_stray_pixel_follows_its_surroundings():
    cost = np.full((6, 11, 13), 200, np.uint8)
    cost[2] = 20
    cost[:, 5, 6] = 150
    cost[4, 5, 6] = 100  # it alone prefers plane 4
    total = aggregate_paths(cost, np.zeros((11, 13), np.float32), 20, 160)
    assert np.all(np.argmin(total, axis=0) == 2)


def test_surfaces_on_both_sides_of_a_step_stay():
    cost = np.full((8, 10, 20), 200, np.uint8)
    cost[1, :, :10] = cost[6, :, 10:] = 10
    index = np.argmin(aggregate_paths(cost, np.zeros((10, 20), np.float32), 20, 160), axis=0)
    assert np.all(index[:, :10] == 1) and np.all(index[:, 10:] == 6)


def test_a_parabola_is_found_between_planes():
    planes = np.arange(9)[:, None, None]
    total = (100 + 40 * (planes - np.array([[3.25, 5.75]])) ** 2).astype(np.uint16)
    position, margin = find_best_planes(total, np.ones(total.shape, bool))
    assert position == pytest.approx(np.array([[3.25, 5.75]]), abs=0.01)
    assert np.all(margin > 1)


def test_only_allowed_planes_are_taken():
    total = np.array([5, 9, 3, 9, 7], np.uint16)[:, None, None].repeat(2, axis=2)
    allowed = np.array([[1, 1, 0, 0, 0], [0, 0, 0, 0, 0]], bool).T[:, None]
    position, margin = find_best_planes(total, allowed)
    assert position[0, 0] == 0 and position[0, 1] == -1
    assert margin[0, 1] == 0


def test_a_view_that_shows_nothing_of_the_stack_has_no_depth(box):
    views, _, carved, _ = box
    blank = replace(views[0], labels=np.zeros_like(views[0].labels))
    found = depth_from_pictures([blank, *views[1:4]], carved)
    assert isinstance(found[0], View) and not found[0].depth.any()
