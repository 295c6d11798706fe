# SPDX-License-Identifier: Apache-2.0
"""V and the container against closed forms."""

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter.config import ReconstructorConfig
from stack_counter.container.construction import make_container
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import volume_model
from stack_counter.pipeline import StackCounter
from stack_counter.reconstruction.stack_volume import find_floor, measure_stack
from stack_counter.types import Mesh


def reconstruct(scene, noise=0.0, views=12, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in scene.views(views, noise=noise):
        stack.add_view(view)
    return stack.volume()


BOX = (0.2 * 0.15 * 0.06, lambda: Scene().box([0.02, 0.01, 0.03], [0.2, 0.15, 0.06], 0.3))
CYLINDER = (np.pi * 0.1**2 * 0.08, lambda: Scene().cylinder(0.02, 0.01, 0.1, 0.08))


@pytest.mark.parametrize("noise", [0.0, 0.001])
@pytest.mark.parametrize("solid", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_heap_within_3_percent_at_2_mm(solid, noise):
    truth, scene = solid
    result = reconstruct(scene(), noise)
    assert result.container.kind == "none"
    assert result.stack_volume == pytest.approx(truth, rel=0.03)


@pytest.mark.parametrize("solid", [BOX, CYLINDER], ids=["box", "cylinder"])
def test_error_falls_with_the_voxel(solid):
    truth, scene = solid
    errors = [abs(reconstruct(scene(), voxel_size=s).stack_volume / truth - 1)
              for s in (0.008, 0.004, 0.002)]
    assert errors[0] > errors[1] > errors[2], errors


@pytest.mark.parametrize("wall, x, y, yaw", [(0.002, 0.03, -0.02, 0.4), (0.005, 0.0, 0.0, 0.0),
                                             (0.008, -0.05, 0.04, 1.0), (0.012, 0.1, 0.1, 2.2)])
def test_bin_is_found_and_filled_to_within_3_percent(wall, x, y, yaw):
    inner, fill = (0.3, 0.2, 0.12), 0.07
    scene = Scene().bin(inner, wall, wall, fill, x, y, yaw)
    result = reconstruct(scene, noise=0.001)
    assert sum(result.volume_parts.values()) == pytest.approx(result.stack_volume)
    assert 0 < result.volume_parts["wall"] < 0.1 * result.stack_volume
    box = result.container
    assert box.kind == "box"
    # Which of the two sides is called x is free.
    sides = sorted(box.inner_size_m[:2], reverse=True)
    assert sides == pytest.approx(inner[:2], rel=0.01)
    assert box.T_world_container[:2, 3] == pytest.approx([x, y], abs=0.002)
    found = np.arctan2(box.T_world_container[1, 0], box.T_world_container[0, 0])
    turn = (found - yaw + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert abs(turn) < np.deg2rad(0.5)
    assert box.wall_thickness_m == pytest.approx(wall, abs=0.0015)
    assert result.stack_volume == pytest.approx(0.3 * 0.2 * fill, rel=0.03)
    assert abs(result.stack_volume / (0.3 * 0.2 * fill) - 1) \
        < 3 * result.stack_volume_std / result.stack_volume


def test_empty_bin_holds_nothing():
    result = reconstruct(Scene().bin((0.3, 0.2, 0.12), 0.005, 0.005, 0.0, yaw=0.4), noise=0.001)
    assert result.container.kind == "box"
    assert (result.stack_volume, result.stack_volume_std) == (0.0, 0.0)


def test_configured_container_is_used_as_given():
    scene = Scene().bin((0.3, 0.2, 0.12), 0.005, 0.009, 0.07, 0.03, -0.02, 0.4)
    given = reconstruct(scene, container_kind="box", container_pose="given",
                        container_inner_size_m=(0.3, 0.2, 0.12), container_wall_m=0.005,
                        container_floor_m=0.009, container_xyyaw=(0.03, -0.02, 0.4))
    assert given.container.inner_size_m == pytest.approx((0.3, 0.2, 0.12), abs=1e-6)
    assert given.stack_volume == pytest.approx(0.3 * 0.2 * 0.07, rel=0.02)
    found = reconstruct(scene, container_floor_m=0.009)  # the floor alone is told
    assert found.stack_volume == pytest.approx(0.3 * 0.2 * 0.07, rel=0.03)


def test_a_box_that_is_wanted_and_not_there_is_an_error():
    with pytest.raises(ScanError, match="no box container found"):
        reconstruct(BOX[1](), container_kind="box")


def test_bare_table_counts_nothing_and_says_so():
    result = reconstruct(Scene(), noise=0.0005)
    assert result.stack_volume == 0 and "nothing_found" in result.reasons


# The integral alone: a level surface of two triangles in a bin that is known.
INNER, WALL, FLOOR, PLANE = (0.3, 0.2, 0.1), 0.004, 0.006, 0.25
REGION = Region(np.array([-0.3, -0.3, 0.2]), np.array([0.3, 0.3, 0.5]), PLANE, 0.001)


def level_surface(z, low=(-0.3, -0.3), high=(0.3, 0.3)):
    """Horizontal rectangle at a world height, metres, seen from above."""
    (x, y), (u, v) = low, high
    return Mesh(np.array([[x, y, z], [u, y, z], [u, v, z], [x, v, z]], np.float32),
                np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def measure_bin(mesh, floor_known=True, one_side=False, draft=0.0):
    wall = BoxWall(np.array([0, 0, 0, INNER[0] + 2 * WALL, INNER[1] + 2 * WALL, draft]))
    container = make_container(wall, WALL, FLOOR + INNER[2], FLOOR, PLANE)
    return measure_stack(FusedSurface(mesh), container, REGION, 0.002, floor_known, one_side)


def test_a_bin_filled_level_holds_area_times_height():
    stack = measure_bin(level_surface(PLANE + FLOOR + 0.04))
    height = 0.04 + volume_model().worn_height_m
    assert stack.stack_volume == pytest.approx(0.3 * 0.2 * height, rel=1e-4)
    assert stack.coverage == 1
    assert stack.fill_level == pytest.approx([height / 0.1] * 3, rel=1e-4)
    assert stack.boundary.rim_length == pytest.approx(1.0)
    assert stack.boundary.opening_area == pytest.approx(0.06)


@pytest.mark.parametrize("one_side", [False, True])
def test_the_unseen_half_counts_its_hidden_share(one_side):
    stack = measure_bin(level_surface(PLANE + FLOOR + 0.04, low=(0, -0.3)), one_side=one_side)
    model = volume_model()
    share = model.hidden_share_one_side if one_side else model.hidden_share
    assert stack.coverage == pytest.approx(0.5)
    assert stack.stack_volume == pytest.approx(
        0.03 * (0.04 * (1 + share) + 2 * model.worn_height_m), rel=1e-3)
    assert stack.integral.filled_in == pytest.approx(
        0.03 * (0.04 * share + model.worn_height_m), rel=1e-3)


def test_one_unseen_cell_is_filled_in():
    pitch, n = 0.002, 150 * 100
    x, y = 40 * pitch - 0.15, 30 * pitch - 0.1  # a corner of a cell
    z = PLANE + FLOOR + 0.04
    strips = [level_surface(z, (-0.3, -0.3), (x, 0.3)),
              level_surface(z, (x + pitch, -0.3), (0.3, 0.3)),
              level_surface(z, (x, -0.3), (x + pitch, y)),
              level_surface(z, (x, y + pitch), (x + pitch, 0.3))]
    mesh = Mesh(np.concatenate([s.vertices for s in strips]),
                np.concatenate([s.triangles + 4 * i for i, s in enumerate(strips)]))
    stack = measure_bin(mesh)
    model = volume_model()
    assert stack.coverage == pytest.approx(1 - 1 / n, abs=1e-9)
    assert not stack.seen[30, 40] and np.count_nonzero(~stack.seen) == 1
    assert stack.stack_volume == pytest.approx(
        pitch**2 * (0.04 * (n - 1 + model.hidden_share) + n * model.worn_height_m), rel=1e-5)


def test_what_stands_behind_a_leaning_wall_is_not_the_stack():
    fill = PLANE + FLOOR + 0.08
    inside = level_surface(fill, (-0.13, -0.08), (0.13, 0.08))
    behind = level_surface(PLANE)  # shows through the wall around it
    mesh = Mesh(np.concatenate([inside.vertices, behind.vertices]),
                np.concatenate([inside.triangles, behind.triangles + 4]))
    stack = measure_bin(mesh, draft=0.5)
    whole = measure_bin(level_surface(fill), draft=0.5)
    opening = np.isfinite(stack.top.heights)
    kept = (stack.seen & ~stack.below)[opening].mean()
    assert kept == pytest.approx(0.26 * 0.16 / 0.06, abs=0.01)
    assert stack.top.heights[opening].min() == pytest.approx(FLOOR + 0.08, abs=1e-6)
    assert whole.stack_volume > stack.stack_volume > 0.95 * whole.stack_volume


def test_a_floor_that_shows_replaces_the_assumed_one():
    stack = measure_bin(level_surface(PLANE + 0.007), floor_known=False)
    assert stack.container.floor_thickness_m == pytest.approx(0.007, rel=1e-4)
    assert stack.container.inner_size_m[2] == pytest.approx(0.099, rel=1e-4)
    assert stack.stack_volume == 0 and stack.boundary.assumed_floor == 0


def test_a_floor_that_does_not_show_is_assumed():
    stack = measure_bin(level_surface(PLANE + 0.05), floor_known=False)
    assert stack.container.floor_thickness_m == FLOOR
    assert stack.boundary.assumed_floor == FLOOR


@pytest.mark.parametrize("cells, height, found", [
    (slice(0, 30), 0.006, True), (slice(0, 8), 0.006, False), (slice(0, 30), 0.02, False)])
def test_a_floor_shows_where_enough_of_it_lies_level_as_high_as_expected(cells, height, found):
    heights = np.full((100, 100), 0.06)
    heights[cells, cells] = height
    floor = find_floor(heights, np.ones((100, 100), bool), 0.006, 0.1)
    assert (floor is not None) == found
    assert floor is None or floor == pytest.approx(height)
