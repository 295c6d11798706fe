# SPDX-License-Identifier: Apache-2.0
"""The fused surface against closed forms."""

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.tsdf import Tsdf


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, 3.9])
def test_an_oblique_plane_lies_where_the_depth_image_says(turn):
    """Half a pixel beside its place it would lie 0.6 mm too low, from any side alike; pixels that
    beat with voxels leave up to 0.2 mm."""
    away = np.array([np.sin(0.7) * np.cos(turn), np.sin(0.7) * np.sin(turn), np.cos(0.7)])
    view = Scene().view(geometry.look_at(1.2 * away, np.zeros(3)))
    tsdf = Tsdf(0.002, 4.0, 3.0, 20.0, 1000.0)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    corner = geometry.pose(np.eye(3), np.array([-0.1, -0.1, 0]))
    heights = (
        FusedSurface(tsdf.extract_triangle_mesh(1)).heights(corner, 0.002, (100, 100)).heights
    )
    assert np.isfinite(heights).all()
    assert heights.mean() == pytest.approx(0, abs=3e-4)


def test_what_too_few_views_have_seen_is_no_surface():
    view = Scene().view(geometry.look_at(np.array([0, 0, 1.2]), np.zeros(3)))
    tsdf = Tsdf(0.004, 4.0, 3.0, 20.0, 1000.0)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    assert len(tsdf.extract_triangle_mesh(1).triangles)
    assert not len(tsdf.extract_triangle_mesh(2).triangles)


def test_a_view_of_nothing_to_keep_only_carves():
    view = Scene().view(geometry.look_at(np.array([0, 0, 1.2]), np.zeros(3)))
    tsdf = Tsdf(0.002, 4.0, 3.0, 20.0, 1000.0)
    nothing = np.zeros(view.depth.shape, bool)
    tsdf.integrate(view.depth, nothing, view.intrinsics, view.T_world_camera)
    assert not len(tsdf.extract_triangle_mesh(1).triangles)
    few = nothing.copy()
    few[101, 203] = True  # between the pixels that Open3D looks at
    tsdf.integrate(view.depth, few, view.intrinsics, view.T_world_camera)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    assert len(tsdf.extract_triangle_mesh(1).triangles)


def above(stands, height=1.0):
    """A view from above of a box 20 cm wide and 10 cm high on a plane, or of the plane alone."""
    scene = Scene().box((0, 0, 0.05), (0.2, 0.2, 0.1)) if stands else Scene()
    return scene.view(geometry.look_at(np.array([0.02, 0, height]), np.zeros(3)))


def test_a_mesh_is_seen_as_by_the_camera_that_gave_it():
    view = above(True)
    tsdf = Tsdf(0.002, 2.0, 3.0, 20.0, 1000.0)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    seen = FusedSurface(tsdf.extract_triangle_mesh(1)).depth(view.intrinsics, view.T_world_camera)
    both = seen > 0
    assert both.mean() > 0.95
    assert np.median(np.abs(seen - view.depth)[both]) < 2e-4
    assert np.mean(np.abs(seen - view.depth)[both] < 0.004) > 0.99


def test_what_is_forgotten_is_gone_with_the_next_view():
    full, empty = above(True), above(False)
    corner = geometry.pose(np.eye(3), np.array([-0.05, -0.05, 0]))
    left = {}
    for forgets in (False, True):
        tsdf = Tsdf(0.002, 2.0, 3.0, 20.0, 1000.0)
        for _ in range(8):
            tsdf.integrate(full.depth, full.depth > 0, full.intrinsics, full.T_world_camera)
        if forgets:
            tsdf.clear_rays(np.abs(full.depth - empty.depth) > 0.003, empty.depth,
                            empty.intrinsics, empty.T_world_camera)
        tsdf.integrate(empty.depth, empty.depth > 0, empty.intrinsics, empty.T_world_camera)
        mesh = tsdf.extract_triangle_mesh(1)
        left[forgets] = FusedSurface(mesh).heights(corner, 0.002, (50, 50)).heights
    assert np.median(left[False]) > 0.09  # eight views outvote one
    assert np.nanmax(np.abs(left[True])) < 0.001


def test_nothing_changed_forgets_nothing():
    view = above(True)
    tsdf = Tsdf(0.002, 2.0, 3.0, 20.0, 1000.0)
    tsdf.clear_rays(np.ones(view.depth.shape, bool), view.depth, view.intrinsics,
                    view.T_world_camera)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    before = tsdf.extract_triangle_mesh(1)
    tsdf.clear_rays(np.zeros(view.depth.shape, bool), view.depth, view.intrinsics,
                    view.T_world_camera)
    assert len(tsdf.extract_triangle_mesh(1).triangles) == len(before.triangles)
