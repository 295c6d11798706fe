"""The fused surface against closed forms."""

import numpy as np
import pytest
from analytic import Scene

from stack_counter import geometry
from stack_counter.tsdf import TopView, Tsdf


@pytest.mark.parametrize("turn", [0.0, np.pi / 2, np.pi, 3.9])
def test_an_oblique_plane_lies_where_the_depth_image_says(turn):
    """Half a pixel beside its place it would lie 0.6 mm too low, from any side alike; pixels that
    beat with voxels leave up to 0.2 mm."""
    away = np.array([np.sin(0.7) * np.cos(turn), np.sin(0.7) * np.sin(turn), np.cos(0.7)])
    view = Scene().view(geometry.look_at(1.2 * away, np.zeros(3)))
    tsdf = Tsdf(0.002, 4.0, 3.0, 20.0, 1000.0)
    tsdf.integrate(view.depth, view.depth > 0, view.intrinsics, view.T_world_camera)
    corner = geometry.pose(np.eye(3), np.array([-0.1, -0.1, 0]))
    heights = TopView(tsdf.extract_triangle_mesh(1)).heights(corner, 0.002, (100, 100)).heights
    assert np.isfinite(heights).all()
    assert heights.mean() == pytest.approx(0, abs=3e-4)


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
