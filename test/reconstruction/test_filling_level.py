# SPDX-License-Identifier: Apache-2.0
"""The filling level of bins and bowls against closed forms."""

import numpy as np
import pytest

from stack_counter.container.construction import make_container
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.fusion.region import Region
from stack_counter.fusion.surface import FusedSurface
from stack_counter.fusion.volume_model import volume_model
from stack_counter.reconstruction.filling_level import measure_filling_level
from stack_counter.reconstruction.stack_volume import measure_stack
from stack_counter.types import Mesh

INNER, WALL, FLOOR, PLANE, PITCH = (0.3, 0.2, 0.1), 0.004, 0.006, 0.25, 0.002
REGION = Region(np.array([-0.3, -0.3, 0.2]), np.array([0.3, 0.3, 0.5]), PLANE, 0.001)
WORN = volume_model().worn_height_m


def slope(low, high, x=(-0.3, 0.3), y=(-0.3, 0.3)):
    """A plane that rises along x from one height over the floor to another, m, seen from above."""
    corners = [[x[0], y[0], low], [x[1], y[0], high], [x[1], y[1], high], [x[0], y[1], low]]
    return Mesh((np.array(corners) + [0, 0, PLANE + FLOOR]).astype(np.float32),
                np.array([[0, 1, 2], [0, 2, 3]], np.int32))


def level_of(mesh, cells=10, draft=0.0, yaw=0.0):
    wall = BoxWall(np.array([0.02, 0.01, yaw, INNER[0] + 2 * WALL, INNER[1] + 2 * WALL, draft]))
    container = make_container(wall, WALL, FLOOR + INNER[2], FLOOR, PLANE)
    return measure_filling_level(
        measure_stack(FusedSurface(mesh), container, REGION, PITCH, True), cells)


def test_a_level_bin_is_as_full_in_every_cell():
    level = level_of(slope(0.04, 0.04))
    assert level.cell_count == (10, 7) and len(level.cells) == 70
    for cell in (level.overall, *level.cells):
        percent, free = cell.level_in_percent, cell.level_free_in_meters
        assert [percent.min, percent.mean, percent.max] == pytest.approx(
            [100 * (0.04 + WORN) / 0.1] * 3, rel=1e-3)
        assert [free.min, free.mean, free.max] == pytest.approx([0.06 - WORN] * 3, rel=1e-3)
        assert cell.coverage == 1


def test_cells_lie_side_by_side_along_the_container():
    level = level_of(slope(0.04, 0.04), cells=6, yaw=0.3)
    assert level.cell_count == (6, 4)
    position = np.array([cell.cell_position for cell in level.cells]).reshape(4, 6, 3)
    assert position[..., 2] == pytest.approx(PLANE + FLOOR + INNER[2])
    along = np.array([np.cos(0.3), np.sin(0.3)])
    assert position[0, 1, :2] - position[0, 0, :2] == pytest.approx(0.05 * along, abs=1e-6)
    assert position.mean(axis=(0, 1))[:2] == pytest.approx([0.02, 0.01], abs=0.001)
    assert level.overall.cell_size == pytest.approx(INNER[:2], abs=PITCH)
    assert sum(np.prod(cell.cell_size) for cell in level.cells) == pytest.approx(
        np.prod(level.overall.cell_size))


def test_a_slope_rises_from_cell_to_cell_and_over_the_rim():
    level = level_of(slope(-0.10, 0.20), cells=10)  # 0.05 m over the floor in the world's middle
    means = np.reshape([cell.level_in_percent.mean for cell in level.cells], (7, 10))
    middle = 0.05 + 0.5 * (np.array([c.cell_position[0] for c in level.cells[:10]]))
    assert means[3] == pytest.approx(np.maximum(100 * (middle + WORN) / 0.1, 0), abs=1)
    assert level.overall.level_in_percent.max > 100
    steep = level_of(slope(-0.30, 0.50))
    assert steep.overall.level_free_in_meters.min < 0
    assert steep.cells[9].level_in_percent.min > 100


@pytest.mark.parametrize("draft", [0.0, 0.1, 0.6])
def test_leaning_walls_neither_fill_an_empty_bin_nor_leave_room_in_a_full_one(draft):
    for height, percent in ((0.0, 0), (0.1, 100)):
        level = level_of(slope(height, height), cells=8, draft=draft)
        means = [cell.level_in_percent.mean for cell in level.cells]
        assert means == pytest.approx([percent] * len(means), abs=6)
        assert level.overall.level_in_percent.mean == pytest.approx(percent, abs=2)


def round_level(mesh, bulge):
    wall = RoundWall(np.array([0, 0, 0.1 + WALL, 0.0, bulge]))
    container = make_container(wall, WALL, FLOOR + 0.1, FLOOR, PLANE)
    return measure_filling_level(
        measure_stack(FusedSurface(mesh), container, REGION, PITCH, True), 10)


@pytest.mark.parametrize("height, percent", [(0.0, 0), (0.1, 100)])
def test_a_bowl_is_full_when_it_is_full_to_the_rim(height, percent):
    level = round_level(slope(height, height), bulge=0.9)
    means = np.array([cell.level_in_percent.mean for cell in level.cells])
    assert np.nanmax(np.abs(means - percent)) < 10
    assert level.overall.level_in_percent.mean == pytest.approx(percent, abs=3)
    assert level.overall.level_free_in_meters.max < (0.11 if not percent else 0.005)


def test_cells_beside_a_round_opening_have_no_level():
    level = round_level(slope(0.05, 0.05), bulge=0.0)
    assert level.cell_count == (10, 10)
    means = np.reshape([cell.level_in_percent.mean for cell in level.cells], (10, 10))
    corners = means[[0, 0, -1, -1], [0, -1, 0, -1]]
    assert np.isnan(corners).all() and level.cells[0].coverage == 0
    assert np.nanmin(means) == pytest.approx(np.nanmax(means)) == pytest.approx(
        100 * (0.05 + WORN) / 0.1, rel=1e-3)


def test_a_grid_has_no_more_cells_than_its_map():
    wall = BoxWall(np.array([0, 0, 0, 0.008 + 2 * WALL, 0.006 + 2 * WALL, 0.0]))
    container = make_container(wall, WALL, FLOOR + 0.1, FLOOR, PLANE)
    stack = measure_stack(FusedSurface(slope(0.05, 0.05)), container, REGION, PITCH, True)
    assert measure_filling_level(stack, 10).cell_count == (4, 3)


def test_unseen_cells_say_so():
    level = level_of(slope(0.04, 0.04, x=(0.02, 0.4)), cells=2)
    assert [cell.coverage for cell in level.cells] == pytest.approx([0, 1], abs=0.02)
    assert level.overall.coverage == pytest.approx(0.5, abs=0.02)
