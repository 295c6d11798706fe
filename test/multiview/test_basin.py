# SPDX-License-Identifier: Apache-2.0
"""Open containers in what was carved as closed: closed forms, and views on a bare wall."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.multiview.basin import find_basin, measure_basin
from stack_counter.multiview.scan import StereoScan
from stack_counter.multiview.visual_hull import carve_visual_hull
from stack_counter.types import (
    CONTAINER,
    PARTS,
    Container,
    HeightMap,
    Intrinsics,
    StackVolume,
    ViewTally,
)

PITCH = 0.002
CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


def can(fill, radius=0.06, wall=0.006, height=0.1):
    """Heights of a can around the middle of a map, filled to a height; NaN outside of it."""
    y, x = (np.mgrid[:80, :80] - 39.5) * PITCH
    r = np.hypot(x, y)
    heights = np.where(r < radius, fill, np.where(r < radius + wall, height, np.nan))
    return HeightMap(np.eye(4), PITCH, heights.astype(np.float32))


def test_what_lies_in_a_can_is_measured_without_its_wall_and_floor():
    top = can(fill=0.05)
    basin = find_basin(top)
    area = np.pi * 0.06**2
    assert np.count_nonzero(basin.cells) * PITCH**2 == pytest.approx(area, rel=0.03)
    assert basin.rim_height == pytest.approx(0.1)
    assert basin.wall_m == pytest.approx(0.006, abs=0.002)
    fill = measure_basin(basin, top, surface_std=0.0)
    assert fill.volume == pytest.approx(area * (0.05 - basin.wall_m), rel=0.03)
    assert fill.volume_std == pytest.approx(area * basin.wall_m, rel=0.03)
    assert np.array_equal(np.isfinite(fill.inner.heights), basin.cells)


@pytest.mark.parametrize("fill", [0.098, 0.13])
def test_a_full_can_holds_no_water(fill):
    assert find_basin(can(fill)) is None


def test_a_bag_with_dents_is_closed():
    top = can(fill=0.1)
    random = np.random.default_rng(0)
    dents = top.heights - random.uniform(0, 0.01, top.heights.shape).astype(np.float32)
    assert find_basin(replace(top, heights=dents)) is None
    nothing = np.full_like(top.heights, np.nan)
    assert find_basin(replace(top, heights=nothing)) is None


def views_of_a_bin(fill):
    """Ideal depth and labels of a bin; its wall is bare, so that stereo measures none of it."""
    views = []
    for view in Scene().bin((0.16, 0.12, 0.07), 0.008, 0.008, fill).views(
            12, 0.5, (0, 0, 0.03), tilts=(12, 28, 42), camera=CAMERA):
        points = geometry.world_points(view)
        inside = np.all(np.abs(points[..., :2]) < np.array([0.08, 0.06]) - 1e-4, axis=-1)
        parts = inside & (points[..., 2] < 0.008 + fill + 1e-4)
        labels = np.where(parts, PARTS, CONTAINER)
        labels = np.where(points[..., 2] > 1e-4, labels, 0).astype(np.uint8)
        views.append(replace(view, depth=np.where(labels == CONTAINER, 0, view.depth),
                             labels=labels))
    return views


def carved(views):
    """The views measured as a closed container, and what was said of that but for depth."""
    scan = StereoScan(views, carve_visual_hull(views, 0.006, 0.5), np.eye(4))
    heap = StackVolume(0, 1e-3, 0.0, Container("none", np.eye(4)), (0, 0, 0), 1.0, None, None,
                       None, ViewTally())
    assert scan.is_closed(heap, ReconstructorConfig())
    found = scan.carved(heap, 0.003)
    return found, [r for r in found.reasons if r != "no_depth"]


def test_a_bin_whose_wall_was_not_found_counts_as_open_where_views_look_into_it():
    found, reasons = carved(views_of_a_bin(fill=0.03))
    assert reasons == ["container_unsure"]
    assert found.stack_volume == pytest.approx(0.16 * 0.12 * 0.03, rel=0.25)
    assert abs(found.stack_volume - 0.16 * 0.12 * 0.03) < 2 * found.stack_volume_std


def test_a_full_bin_whose_walls_count_is_unsure():
    assert carved(views_of_a_bin(fill=0.07))[1] == ["container_unsure"]


def test_a_bag_whose_parts_show_through_its_sides_is_closed():
    views = []
    for view in views_of_a_bin(fill=0.07):
        stack = view.labels != 0
        printed = np.arange(stack.shape[1]) % 40 < 10  # stripes that hide parts
        labels = np.where(printed, CONTAINER, PARTS) * stack
        ideal = Scene().box((0, 0, 0.039), (0.176, 0.136, 0.078)).view(
            view.T_world_camera, CAMERA).depth
        views.append(replace(view, labels=labels.astype(np.uint8),
                             depth=np.where(labels == PARTS, ideal, 0).astype(np.float32)))
    found, reasons = carved(views)
    assert reasons == []
    assert found.stack_volume == pytest.approx(0.176 * 0.136 * 0.078, rel=0.15)
