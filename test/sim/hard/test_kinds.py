# SPDX-License-Identifier: Apache-2.0
"""Scans made hard on purpose: what is wrong in them, and their truth."""

import re

import numpy as np
import pytest
import trimesh

from stack_counter import geometry
from stack_counter.sim.hard.kinds import HARD_KINDS, hard_kind, make_hard_scan
from stack_counter.sim.hard.piles import outer_size, parts_within, placed, scaled
from stack_counter.sim.hard.world import block, floor, record_world
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene
from stack_counter.sim.shapes import shape_from_mesh

SIDE = 0.02  # of a cube, m


def cubes_in_a_bin():
    """Five by four by two cubes, 1 mm apart, in a drafted bin."""
    cube = trimesh.creation.box([SIDE] * 3)
    x, y, z = np.meshgrid(np.arange(5) - 2, np.arange(4) - 1.5, np.arange(2) + 0.5)
    places = np.stack([x, y, z], axis=-1).reshape(-1, 3) * [SIDE + 1e-3, SIDE + 1e-3, SIDE]
    poses = np.column_stack([places + [0, 0, 0.002], np.tile([0, 0, 0, 1.0], (len(places), 1))])
    container = ContainerShape("bin", np.eye(4), (0.13, 0.11, 0.06), 0.002, 0.002, 0.08)
    return Scene(0, 0, shape_from_mesh(cube.vertices, cube.faces, "cube"), container, poses)


PILE = cubes_in_a_bin()


def scans_of(kind, number=3):
    first = list(HARD_KINDS).index(kind)
    return [make_hard_scan(1, first + i * len(HARD_KINDS), [PILE]) for i in range(number)]


def test_all_kinds_come_in_turn():
    assert [hard_kind(n) for n in range(2 * len(HARD_KINDS))] == [*HARD_KINDS] * 2


@pytest.mark.parametrize("number", range(len(HARD_KINDS)))
def test_a_scan_depends_on_seed_and_number_alone(number):
    one, again = (make_hard_scan(5, number, [PILE]) for _ in range(2))
    assert (one.what, one.count, one.config) == (again.what, again.count, again.config)
    for a, b in zip(one.views, again.views, strict=True):
        assert np.array_equal(a.depth, b.depth)
        assert np.array_equal(a.T_world_camera, b.T_world_camera)


def test_a_region_among_neighbours_holds_one_bin():
    for scan in scans_of("neighbours", 6):
        if any(scan.config.roi_size_m):
            size = outer_size(PILE)
            assert size[0] <= scan.config.roi_size_m[0] <= size[0] + 0.03
            assert scan.count in (0, 20, 40)
        else:
            assert scan.count % 20 == 0


def test_a_raised_bin_keeps_its_parts():
    assert {scan.count for scan in scans_of("raised")} == {40}


def floor_heights(view):
    """Median height of what a view shows, m: mostly the floor, at 0."""
    points = geometry.world_points(view, 4).reshape(-1, 3)
    return float(np.nanmedian(points[:, 2]))


def test_one_view_alone_is_off():
    for scan in scans_of("one view short"):
        off = [abs(floor_heights(view)) > 0.015 for view in scan.views]
        assert sum(off) == 1
        assert scan.what.startswith(f"view {off.index(True) + 1} of {len(off)} ")


def test_two_poses_are_exchanged():
    for scan in scans_of("views swapped"):
        off = [abs(floor_heights(view)) > 0.01 for view in scan.views]
        named = [int(word) - 1 for word in re.findall(r"\d", scan.what)[:2]]
        # Poses of the same tilt show the floor in its place: only what stands on it turns.
        assert [i for i, is_off in enumerate(off) if is_off] in ([], named)


def test_few_large_parts_stand_on_the_floor_of_their_bin():
    for scan in scans_of("few large parts"):
        assert 1 <= scan.count <= 6
        assert scan.unit_volume > PILE.shape.unit_volume


def test_without_a_bin_none_is_asked_for():
    assert {scan.count for scan in scans_of("no bin", 6)} == {0}


def test_parts_of_a_region_are_those_whose_middle_lies_in_it():
    low, high = np.array([-1, -1, -1.0]), np.array([1, 0, 1.0])
    assert parts_within(PILE, low, high) == 20
    assert parts_within(placed(PILE, np.array([0, 2, 0])), low, high) == 0


def test_a_scaled_pile_has_the_volume_of_its_scale():
    double = scaled(PILE, 2)
    assert double.truth.unit_volume == pytest.approx(8 * PILE.truth.unit_volume)
    assert double.truth.stack_volume == pytest.approx(8 * PILE.truth.stack_volume, rel=1e-3)


def test_the_foreground_hides_the_world_in_its_view_alone():
    T = np.diag([1.0, -1, -1, 1])
    T[2, 3] = 1.0  # one metre above the floor, looking down
    screen = [block((-0.1, -0.1, 0.4), (0.1, 0.1, 0.5))]
    views = record_world([floor()], [T, T], np.random.default_rng(0), foreground=[[], screen])
    middles = [float(np.median(view.depth[230:250, 310:330])) for view in views]
    assert middles == pytest.approx([1.0, 0.5], abs=0.01)


def test_a_sunk_bin_stands_below_the_table_around_it():
    for scan in scans_of("sunk"):
        points = np.concatenate([geometry.world_points(v, 4).reshape(-1, 3) for v in scan.views])
        beside = np.abs(points[:, 0]) > outer_size(PILE)[0] / 2 + 0.05
        assert abs(np.nanmedian(points[beside, 2])) < 0.003
        assert np.nanmin(points[:, 2]) < -0.005
        assert scan.count == 40


def test_a_sheet_covers_parts_that_count_all_the_same():
    for scan in scans_of("covered"):
        share = int(re.search(r"over (\d+)%", scan.what)[1]) / 100
        assert 0.25 < share < 0.85 and scan.count == 40
        points = np.concatenate([geometry.world_points(v, 4).reshape(-1, 3) for v in scan.views])
        inside = np.all(np.abs(points[:, :2]) < SIDE, axis=1)  # the sheet lies over the middle
        assert np.nanmedian(points[inside, 2]) == pytest.approx(2 * SIDE + 0.004, abs=0.004)
