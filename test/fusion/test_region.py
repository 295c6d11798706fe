# SPDX-License-Identifier: Apache-2.0
"""Support plane, region of interest and voxel size of scenes in closed form."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.region import (
    SETTINGS,
    Region,
    crop_to_region,
    find_pieces,
    find_region,
    largest_blob,
    seen_from_one_side,
)
from stack_counter.fusion.tsdf import automatic_voxel_size, voxel_size_for

CONFIG = ReconstructorConfig()
LOW, HIGH = np.array([-0.08, -0.06, 0.0]), np.array([0.12, 0.06, 0.08])  # of the box
NOISE, STEP = 0.001, 0.008  # m; between points that are looked at


def box_views(scene=None, raised=0.0, **how):
    """Views of a box on the plane, all `raised` metres."""
    scene = (scene or Scene()).box((LOW + HIGH) / 2, HIGH - LOW)
    return [replace(v, T_world_camera=geometry.pose(np.eye(3), np.array([0, 0, raised]))
                    @ v.T_world_camera) for v in scene.views(6, noise=NOISE, **how)]


@pytest.mark.parametrize("raised", [0.0, 0.7])
def test_the_plane_and_a_box_on_it_are_found(raised):
    region = find_region(box_views(raised=raised), CONFIG)
    assert region.plane_z == pytest.approx(raised, abs=2e-4)
    assert region.noise == pytest.approx(NOISE, rel=0.3)
    lift, margin = np.array([0, 0, raised]), SETTINGS.margin
    np.testing.assert_allclose(region.low, LOW + lift - margin, atol=STEP)
    np.testing.assert_allclose(region.high, HIGH + lift + margin, atol=STEP)


def test_a_configured_region_is_used_as_given():
    config = replace(CONFIG, roi_center_m=(0.0, 0.0, 0.04), roi_size_m=(0.3, 0.2, 0.12))
    region = find_region(box_views(), config)
    np.testing.assert_allclose(region.high, [0.15, 0.1, 0.1])
    np.testing.assert_allclose(region.low, [-0.15, -0.1, -SETTINGS.margin], atol=1e-3)
    far = replace(config, roi_center_m=(5.0, 0.0, 0.0))
    with pytest.raises(ScanError, match="0 depth points in the region of interest"):
        find_region(box_views(), far)


def test_poses_in_millimetres_are_refused_before_they_take_all_memory():
    views = box_views()
    for view in views:
        view.T_world_camera[:3, 3] *= 1000
    with pytest.raises(ScanError, match=r"apart; expected below 50 m: .* in metres.*roi_size_m"):
        find_region(views, CONFIG)


def test_the_region_is_around_the_largest_thing_or_around_all_pieces():
    piece = Scene().box((0.27, 0.0, 0.02), (0.08, 0.08, 0.04))
    views = box_views(piece)
    assert find_region(views, CONFIG).high[0] == pytest.approx(0.12 + SETTINGS.margin, abs=STEP)
    assert find_pieces(views, CONFIG).high[0] == pytest.approx(0.31 + SETTINGS.margin, abs=STEP)
    with pytest.raises(ScanError, match="nothing stands"):
        find_pieces(Scene().views(6), CONFIG)


def test_a_view_grows_the_region_by_what_stands_across_its_border():
    views = box_views()
    whole = find_region(views, CONFIG)
    cut = replace(whole, high=np.array([0.05, *whole.high[1:]]))
    grown = cut.grown_by(views[0])
    assert grown.high[0] == pytest.approx(0.12 + SETTINGS.margin, abs=STEP)
    beside = replace(whole, low=whole.low + 1.0, high=whole.high + 1.0)
    assert beside.grown_by(views[0]) is beside


def test_a_region_contains_and_joins():
    a = Region(np.zeros(3), np.ones(3), 0.0, 0.0005)
    b = Region(np.array([0.5, -1, 0]), np.array([2.0, 0.5, 0.5]), 0.1, 0.01)
    points = np.array([[0.5, 0.5, 0.5], [1.5, 0, 0.2], [0, 0, 0], [np.nan, 0, 0]])
    np.testing.assert_array_equal(a.contains(points), [True, False, True, False])
    both = a.union(b)
    np.testing.assert_array_equal(both.contains(points), [True, True, True, False])
    assert both.plane_z == 0.0
    assert (a.noise_height, b.noise_height) == (SETTINGS.min_height, 0.04)


def test_a_cropped_view_still_shows_all_of_the_region():
    region = Region(LOW, HIGH, 0.0, NOISE)
    for view in box_views():
        cropped = crop_to_region(view, region)
        assert cropped.depth.size < 0.5 * view.depth.size
        count = [region.contains(geometry.world_points(v)).sum() for v in (view, cropped)]
        assert count[0] == count[1] > 1000
    far = Region(LOW + [3, 0, 0], HIGH + [3, 0, 0], 0.0, NOISE)
    with pytest.raises(ViewError, match="out_of_sight|expected some inside"):
        crop_to_region(box_views(tilts=(0,))[0], far)


def test_the_largest_blob_is_the_one_with_the_most_points():
    random = np.random.default_rng(0)
    large, small = random.uniform(0, 0.05, (300, 3)), random.uniform(0, 0.05, (100, 3))
    small += [0.2, 0, 0]
    np.testing.assert_array_equal(largest_blob(np.concatenate([small, large])), large)
    assert len(largest_blob(np.zeros((0, 3)))) == 0


@pytest.mark.parametrize("tilt, one_side", [(9.0, True), (11.0, False)])
def test_views_from_one_side_lie_within_a_third_of_a_radian(tilt, one_side):
    """Opposite cameras of a ring are twice its tilt apart: 18 and 22 degrees, the limit 20."""
    center = (LOW + HIGH) / 2
    views = Scene().views(6, center=center, tilts=(tilt,))
    assert seen_from_one_side(views, Region(LOW, HIGH, 0.0, NOISE)) == one_side


@pytest.mark.parametrize("width, unit_volume, want", [
    (0.4, 0.0, 0.002), (1.2, 0.0, 0.003),  # coarser from 0.8 m on
    (0.4, 0.006**3, 0.0015), (0.4, 0.002**3, 0.001), (1.2, 0.05**3, 0.002)])
def test_voxels_follow_the_region_and_the_part(width, unit_volume, want):
    region = Region(np.zeros(3), np.array([width, 0.3, 0.1]), 0.0, 0.0)
    assert automatic_voxel_size(region, unit_volume) == pytest.approx(want)
    if unit_volume:
        assert voxel_size_for(unit_volume) == pytest.approx(want)
