# SPDX-License-Identifier: Apache-2.0
"""Parts placed at known poses are found there again, by their mesh, from noisy heights."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from kits.posed_parts import SHAPE, as_mesh, bracket, lying, parts_on_floor
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.visible_parts.part_views import make_part_views, sample_surface
from stack_counter.visible_parts.pose_guesses import cut_patch, guess_everywhere, judge
from stack_counter.visible_parts.poses import SETTINGS, find_poses

BRACKET = bracket()
LENGTH = (40 * 12 * 8 + 12 * 18 * 8) ** (1 / 3) / 1000  # of it, metres
T_WORLD_MAP = geometry.pose(Rotation.from_euler("z", 0.6).as_matrix(), np.array([1.0, -2, 0.7]))
FLAT, UPSIDE_DOWN, TILTED, ON_EDGE = (
    Rotation.from_euler("xyz", angles, degrees=True).as_matrix()
    for angles in ((0, 0, 70), (180, 0, -40), (25, 30, 10), (90, 0, 20)))


def angle_deg(R_a, R_b):
    return np.degrees(Rotation.from_matrix(R_a.T @ R_b).magnitude())


@pytest.mark.parametrize("rotation", [FLAT, UPSIDE_DOWN, TILTED, ON_EDGE])
def test_a_bracket_is_found_as_it_lies_in_the_axes_of_its_file(rotation):
    T = lying(BRACKET, rotation, (0.1, 0.09))
    top, parts = parts_on_floor(BRACKET, [T], T_WORLD_MAP)
    [pose] = find_poses(parts, 1, top, BRACKET, LENGTH)
    true = T_WORLD_MAP @ T
    assert angle_deg(pose.T_world_part[:3, :3], true[:3, :3]) < 4
    middle = BRACKET.vertices.mean(axis=0)
    assert geometry.apply(pose.T_world_part, middle) == pytest.approx(
        geometry.apply(true, middle), abs=0.0015)
    assert 0.5 < pose.fit <= 1


def test_a_bracket_is_found_although_another_part_lies_on_its_end():
    T = lying(BRACKET, FLAT, (0.1, 0.09))
    box = trimesh.creation.box((0.02, 0.02, 0.02))
    box.apply_translation((*geometry.apply(T, np.array([0.067, 0, 0.01]))[:2], 0.019))
    top, parts = parts_on_floor(BRACKET, [T], covers=[as_mesh(box)])
    alone = parts_on_floor(BRACKET, [T])[1]
    assert np.sum(parts.numbers == 0) < 0.85 * np.sum(alone.numbers == 0)
    [pose] = find_poses(parts, 1, top, BRACKET, LENGTH)
    assert angle_deg(pose.T_world_part[:3, :3], T[:3, :3]) < 5


def test_a_rod_is_found_up_to_its_symmetry():
    rod = as_mesh(trimesh.creation.cylinder(0.006, 0.04))
    T = lying(rod, Rotation.from_euler("xyz", (80, 0, 30), degrees=True).as_matrix(), (0.1, 0.09))
    top, parts = parts_on_floor(rod, [T])
    [pose] = find_poses(parts, 1, top, rod, (np.pi * 0.006**2 * 0.04) ** (1 / 3))
    along, true = pose.T_world_part[:3, 2], T[:3, 2]
    assert abs(along @ true) > np.cos(np.radians(4))
    assert pose.T_world_part[:3, 3] == pytest.approx(T[:3, 3], abs=0.0015)


def test_the_best_parts_alone_have_poses_and_the_fit_tells_a_foreign_one():
    places = [(0.04, 0.09), (0.1, 0.05), (0.16, 0.11)]
    top, parts = parts_on_floor(BRACKET, [lying(BRACKET, FLAT, xy) for xy in places])
    parts = replace(parts, scores=np.array([0.9, 0.8, 0.7]), shares=np.array([0.5, 0.9, 0.9]))
    first, second, third = find_poses(parts, 2, top, BRACKET, LENGTH)
    assert first is None and second.fit > 0.5 and third.fit > 0.5
    assert find_poses(parts, 0, top, BRACKET, LENGTH) == [None] * 3
    ball = as_mesh(trimesh.creation.icosphere(3, 0.012))
    [_, foreign, _] = find_poses(parts, 2, top, ball, LENGTH)
    assert foreign.fit < second.fit - 0.2


def test_a_part_in_too_few_cells_has_none_and_one_in_just_enough_has():
    top, parts = parts_on_floor(BRACKET, [lying(BRACKET, FLAT, (0.1, 0.09))])
    cells = np.argwhere(parts.numbers == 0)
    for count, expected in ((SETTINGS.least_cells - 1, 0), (SETTINGS.least_cells, 1)):
        numbers = np.full(SHAPE, -1, np.int32)
        numbers[tuple(cells[:count].T)] = 0
        poses = find_poses(replace(parts, numbers=numbers), 1, top, BRACKET, LENGTH)
        assert sum(pose is not None for pose in poses) == expected


def test_holes_in_the_surface_are_left_out():
    T = lying(BRACKET, FLAT, (0.1, 0.09))
    top, parts = parts_on_floor(BRACKET, [T])
    top.heights[::5] = np.nan
    [pose] = find_poses(parts, 1, top, BRACKET, LENGTH)
    assert angle_deg(pose.T_world_part[:3, :3], T[:3, :3]) < 4


def test_a_box_looks_as_high_and_wide_as_it_is():
    views = make_part_views(as_mesh(trimesh.creation.box((0.04, 0.02, 0.01))))
    assert views.diameter == pytest.approx(np.sqrt(0.04**2 + 0.02**2 + 0.01**2), rel=0.03)
    assert len(views.rotations) == 200
    up = views.at_rotations(np.eye(3)[None])
    covered = np.isfinite(up.heights[0])
    assert np.median(up.heights[0][covered]) == pytest.approx(0.005, abs=1e-4)
    assert covered.sum() * up.pitch**2 == pytest.approx(0.04 * 0.02, rel=0.2)
    assert up.middles()[0] == pytest.approx([0, 0], abs=up.pitch / 2)
    shown = up.shown_points(0, 1)
    assert np.mean(shown[:, 2] > 0.004) > 0.8  # the rest lies below the top's edge


def test_points_lie_on_the_surface_evenly():
    points = sample_surface(as_mesh(trimesh.creation.box((2, 1, 1))), 5000)
    distance = np.abs(points / [1, 0.5, 0.5]).max(axis=1)
    assert distance == pytest.approx(1, abs=1e-6)
    assert np.mean(np.abs(points[:, 0]) > 0.999999) == pytest.approx(0.2, abs=0.01)  # 2 of 10


def test_the_fit_of_a_flat_plate_is_one_at_its_place_and_none_high_above_a_hole():
    """A plate that fills the segment fits; half of it beside the segment halves the fit."""
    plate = as_mesh(trimesh.creation.box((0.04, 0.04, 0.001)))
    T = lying(plate, np.eye(3), (0.1, 0.09))
    top, parts = parts_on_floor(plate, [T], noise=0)
    top.heights[parts.numbers == 0] = 0.02  # it lies higher
    views = make_part_views(plate).at_rotations(np.eye(3)[None])
    whole = judge(views, guess_everywhere(views, 1), cut_patch(top, parts.numbers == 0, 0.02,
                                                              0.02))
    assert whole.fit[0] > 0.9
    half = (parts.numbers == 0) & (np.arange(SHAPE[1]) < 50)
    split = judge(views, replace(guess_everywhere(views, 1), shift=np.array([[0.01, 0]])),
                  cut_patch(replace(top, heights=np.where(half, 0.02, 0)), half, 0.04, 0.02))
    assert split.fit[0] == pytest.approx(0.5, abs=0.06)
