# SPDX-License-Identifier: Apache-2.0
"""Bins that stand on a board, on rails or on the plane, in closed form: where their floor is."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.container.base import find_lower_edge
from stack_counter.container.wall_fit import FacePoints
from stack_counter.container.wall_shapes import BoxWall
from stack_counter.errors import ScanError
from stack_counter.pipeline import StackCounter
from stack_counter.types import BACKGROUND, CONTAINER, View

INNER, WALL, FILL, LIFT = (0.18, 0.12, 0.07), 0.004, 0.03, 0.028
V = INNER[0] * INNER[1] * FILL
BOARD = [((0, 0, LIFT / 2), (0.28, 0.22, LIFT))]
RAILS = [((x, 0, LIFT / 2), (0.02, 0.1, LIFT)) for x in (-0.06, 0.06)]


def raised_views(supports, lift=LIFT, tilts=(20, 45), plane=True, fill=FILL):
    """Six views of a bin whose underside lies `lift` above the plane, on boxes."""
    under = Scene(plane)
    for center, size in supports:
        under.box(np.array(center), size)
    above = Scene(plane=False).bin(INNER, WALL, WALL, fill)
    down, views = np.array([0, 0, lift]), []
    for view in under.views(6, tilts=tilts):
        T = geometry.pose(np.eye(3), -down) @ view.T_world_camera
        bin_depth = above.view(T).depth
        ground = np.asarray(view.depth)
        nearest = np.where((bin_depth > 0) & (bin_depth < ground), bin_depth, ground)
        noise = np.random.default_rng(view.stamp_ns // 10**9).normal(0, 5e-4, ground.shape)
        views.append(View(view.stamp_ns, view.intrinsics, view.T_world_camera,
                          depth=(nearest + noise).astype(np.float32)))
    return views


def labelled(views, lift, blur=0.0):
    """The views with labels of the bin, whose lower half may be seen too deep by `blur` metres."""
    out = []
    for view in views:
        points = geometry.world_points(view)
        beside = np.abs(points[..., :2]) - np.array(INNER[:2]) / 2 - WALL
        shown = np.all(beside < 0.002, axis=-1) & (points[..., 2] > lift - 0.003)
        outer = shown & np.any(beside > -0.002, axis=-1) & (points[..., 2] < lift + 0.03)
        out.append(replace(view, labels=np.where(shown, CONTAINER, BACKGROUND).astype(np.uint8),
                           depth=(view.depth + blur * outer).astype(np.float32)))
    return out


def volume(views, **settings):
    stack = StackCounter(ReconstructorConfig(**settings))
    for view in views:
        stack.add_view(view)
    return stack.volume()


@pytest.mark.parametrize("supports, lift, settings", [
    (BOARD, LIFT, {}), (RAILS, LIFT, {}), ([], 0.0, {}),
    (RAILS, LIFT, {"container_base_m": LIFT}),
    (RAILS, LIFT, {"container_inner_size_m": INNER})],
    ids=["board", "rails", "plane", "base given", "depth given"])
def test_the_floor_is_where_the_underside_is(supports, lift, settings):
    found = volume(raised_views(supports, lift), **settings)
    assert found.container.kind == "box"
    assert found.container.T_world_container[2, 3] == pytest.approx(lift, abs=0.004)
    assert found.container.inner_size_m[2] == pytest.approx(INNER[2], abs=0.004)
    assert found.stack_volume == pytest.approx(V, rel=0.08)


def recessed_views(depth, gap, gap_on_one_side=None):
    """Six views of a bin in a recess of a table, so deep and `gap` wider on all sides, metres."""
    x, y = (side / 2 + WALL + gap for side in INNER[:2])
    right = INNER[0] / 2 + WALL + (gap_on_one_side or gap)
    slabs = [((0, s * (y + 0.5), -0.1), (2, 1, 0.2)) for s in (-1, 1)] \
        + [((-x - 0.5, 0, -0.1), (1, 2 * y, 0.2)), ((right + 0.5, 0, -0.1), (1, 2 * y, 0.2))]
    ground = [((0, 0, -depth - 0.05), (2 * right, 2 * y, 0.1))]
    return raised_views([*slabs, *ground], -depth, plane=False, fill=0.06)


@pytest.mark.parametrize("depth, gap, in_reach", [(0.02, 0.015, True), (0.05, 0.01, False)])
def test_a_bin_in_a_recess_stands_lower_than_the_table(depth, gap, in_reach):
    """It is measured where the recess shows whole, and doubted where it is too deep for that."""
    found = volume(recessed_views(depth, gap), container_kind="box")
    if in_reach:
        assert found.container.T_world_container[2, 3] == pytest.approx(-depth, abs=0.004)
        assert found.stack_volume == pytest.approx(2 * V, rel=0.08)
    assert ("wall_short" in found.reasons) == (not in_reach)


def test_a_recess_that_shows_on_one_side_is_doubted():
    found = volume(recessed_views(0.05, 0.004, gap_on_one_side=0.012), container_kind="box")
    assert "wall_short" in found.reasons


def test_a_container_at_a_tables_edge_is_not_doubted():
    """Beside it one sees the floor of the hall, which is no recess."""
    table, hall = ((-0.9 + INNER[0] / 2 + WALL, 0, -0.02), (1.8, 2, 0.04)), \
        ((0, 0, -0.75), (4, 4, 0.1))
    found = volume(raised_views([table, hall], 0.0, plane=False), container_kind="box")
    assert found.stack_volume == pytest.approx(V, rel=0.08)
    assert "wall_short" not in found.reasons


def test_what_labels_call_the_container_is_not_seen_below_it():
    """Stereo sees a plain wall's foot too deep, as if it were what one sees between rails."""
    for supports, lift, blur in (([], 0.0, 0.015), (RAILS, LIFT, 0.0)):
        found = volume(labelled(raised_views(supports, lift), lift, blur))
        assert found.container.T_world_container[2, 3] == pytest.approx(lift, abs=0.004)
        assert found.stack_volume == pytest.approx(V, rel=0.08)


def test_a_given_depth_and_walls_down_to_the_plane_are_a_thick_floor():
    views = raised_views([], 0.0)
    found = volume(views, container_inner_size_m=(*INNER[:2], INNER[2] - 0.02))
    assert found.container.T_world_container[2, 3] == pytest.approx(0.0, abs=0.002)
    assert found.container.floor_thickness_m == pytest.approx(0.02 + WALL, abs=0.002)
    assert "size_disagrees" in found.reasons


def test_a_given_depth_needs_no_plane_in_sight():
    """A camera that sees the bin and nothing beside it: its level fill may be any height."""
    views = []
    for view in raised_views([], 0.0):
        points = geometry.world_points(view)
        beside = np.any(np.abs(points[..., :2]) > np.array(INNER[:2]) / 2 + WALL, axis=-1)
        views.append(View(view.stamp_ns, view.intrinsics, view.T_world_camera,
                          depth=np.where(beside, np.float32(0), view.depth)))
    with pytest.raises(ScanError, match="no support plane in sight.*support_height_m"):
        volume(views)
    for settings in ({"container_inner_size_m": INNER}, {"support_height_m": 0.0}):
        assert volume(views, **settings).stack_volume == pytest.approx(V, rel=0.08)


def test_the_lower_edge_is_the_last_height_without_a_gap():
    rim, shape = 0.1, BoxWall(np.array([0, 0, 0, 0.2, 0.1, 0.0]))
    y = np.linspace(-0.04, 0.04, 30)

    def edge(*heights):
        y2, z = (a.ravel() for a in np.meshgrid(y, np.concatenate(heights)))
        xy = np.stack([np.full(len(z), 0.1), y2], axis=1)
        return find_lower_edge(shape, FacePoints(xy, rim - z, np.zeros(len(z), bool)), rim)
    assert edge(np.arange(0.001, 0.097, 0.001)) == 0.0
    assert edge(np.arange(0.030, 0.097, 0.001)) == pytest.approx(0.03, abs=0.004)
    # What lies at the foot of the wall below a gap is another thing.
    assert edge(np.arange(0.030, 0.097, 0.001), [0.002, 0.003]) == pytest.approx(0.03, abs=0.004)
    assert edge([]) == rim
