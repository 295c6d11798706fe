# SPDX-License-Identifier: Apache-2.0
"""The parts that no view shows: poured as they were counted, and kept below what was seen."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from kits.counted_bin import FLOOR, INNER, counted_bin

from stack_counter import geometry
from stack_counter.errors import PartError
from stack_counter.sim import RayCaster, Scene, shape_from_mesh
from stack_counter.teaching import plausible_arrangement
from stack_counter.teaching.plausible_arrangement import (
    SETTINGS,
    _alike_turns,
    _container_in_map,
    _height_difference,
    _hidden_poses,
    _Pour,
    find_arrangement,
)
from stack_counter.types import Container, HeightMap

BLOCK = shape_from_mesh(*[getattr(trimesh.creation.box((0.05, 0.04, 0.04)), name)
                          for name in ("vertices", "faces")], "block")


def bin_of(count):
    """The slope of `counted_bin`, of which so many parts were counted."""
    return replace(counted_bin(), count=count)


def scene_of(container, *centres):
    """Blocks that lie straight at centres of the container's frame."""
    return Scene(0, 0, BLOCK, container,
                 np.array([[*centre, 0.0, 0.0, 0.0, 1.0] for centre in centres]))


def test_the_measured_container_is_poured_into_where_it_stands():
    volume = counted_bin().volume
    turned = geometry.pose_from_quaternion(np.array([0, 0, 0.6, 0.8]), np.array([0.3, 0.1, 0.7]))
    moved = replace(volume, inner=replace(volume.inner,
                                          T_world_map=turned @ volume.inner.T_world_map),
                    container=replace(volume.container, T_world_container=turned))
    for seen in (volume, moved):
        made = _container_in_map(seen)
        assert made.kind == "bin" and made.inner_size_m == INNER and made.draft_rad == 0
        assert made.T_world_container == pytest.approx(
            geometry.inverse(volume.inner.T_world_map) @ volume.container.T_world_container)


@pytest.mark.parametrize("ribs", [False, True])
def test_walls_are_as_inclined_as_the_opening_grows_smaller(ribs):
    volume = counted_bin().volume
    rows, cols = volume.inner.heights.shape
    row, col = np.mgrid[:rows, :cols]
    from_wall = np.minimum(np.minimum(row, rows - 1 - row), np.minimum(col, cols - 1 - col)) + 0.5
    run = 6  # cells of the map over which the walls come down
    heights = FLOOR + INNER[2] * np.clip(1 - from_wall / run, 0, None)
    if ribs:
        heights[:, ::2] = np.maximum(heights[:, ::2], FLOOR + 0.01)
    made = _container_in_map(replace(volume, inner=replace(volume.inner, heights=heights)))
    assert np.tan(made.draft_rad) == pytest.approx(run * volume.inner.pitch / INNER[2], rel=0.02)


def test_a_shallow_dish_is_made_as_steep_as_a_container_can_be():
    volume = counted_bin().volume
    heights = np.full_like(volume.inner.heights, FLOOR + INNER[2])
    inner = replace(volume.inner, heights=heights)
    made = _container_in_map(replace(volume, inner=inner))
    left = min(INNER[:2]) - 2 * INNER[2] * np.tan(made.draft_rad)
    assert left == pytest.approx(SETTINGS.min_floor_share * min(INNER[:2]))
    wide = replace(volume.container, inner_size_m=(0.6, 0.5, 0.1))
    made = _container_in_map(replace(volume, inner=inner, container=wide))
    assert np.rad2deg(made.draft_rad) == pytest.approx(SETTINGS.max_draft_deg)


def test_a_pile_is_compared_in_the_turns_that_leave_its_container_alike():
    made = _container_in_map(counted_bin().volume)
    x, _, depth = INNER
    middle = made.T_world_container[:3, 3]
    for kind, size, turns in (("bin", INNER, 2), ("bin", (x, x, depth), 4),
                              ("cylinder", (x, x, depth), SETTINGS.round_turns)):
        motions = _alike_turns(replace(made, kind=kind, inner_size_m=size))
        assert len(motions) == turns
        places = np.array([geometry.apply(T, middle + [0.05, 0.0, 0.1]) for T in motions])
        assert np.ptp(np.linalg.norm(places - middle, axis=1)) < 1e-9
        assert places[0] - middle == pytest.approx([0.05, 0.0, 0.1])
        assert places[turns // 2] - middle == pytest.approx([-0.05, 0.0, 0.1])


def test_the_surface_of_a_pile_is_no_height_off_itself_as_it_was_turned():
    volume = counted_bin().volume
    scene = scene_of(_container_in_map(volume), (0.05, 0.0, FLOOR + 0.02),
                     (-0.05, 0.03, FLOOR + 0.05))
    caster = RayCaster(scene.parts_mesh())
    for turn in _alike_turns(scene.container):
        turned = replace(scene, container=replace(
            scene.container, T_world_container=turn @ scene.container.T_world_container))
        top = volume.top
        xy = (np.moveaxis(np.indices(top.heights.shape)[::-1], 0, -1) + 0.5) * top.pitch
        own = np.maximum(RayCaster(turned.parts_mesh()).surface_heights(xy), FLOOR)
        for higher in (0.0, 0.01):
            pour = _Pour(BLOCK, scene.container, 2, (0.3, 0.3),
                         replace(top, heights=(own + higher).astype(np.float32)), volume.inner)
            assert _height_difference(caster, turn, pour) == pytest.approx(higher, abs=1e-5)


def test_parts_that_stand_out_of_the_surface_or_lie_beside_it_are_left_out():
    made = _container_in_map(counted_bin().volume)
    heights = np.full((40, 60), 0.05, np.float32)
    heights[:, :14] = np.nan
    level = HeightMap(np.eye(4), 0.005, heights)
    below, above = (0.0, 0.0, FLOOR + 0.02), (0.08, 0.0, FLOOR + 0.04)
    beside = (-0.1, 0.0, FLOOR + 0.02)
    hidden = _hidden_poses(scene_of(made, below, above, beside), level)
    assert len(hidden) == 1
    assert hidden[0, :3, 3] == pytest.approx(made.T_world_container[:3, 3] + below)


def test_counted_parts_are_arranged_below_the_measured_surface(monkeypatch):
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    monkeypatch.setattr(plausible_arrangement, "SETTINGS", replace(SETTINGS, piles=2))
    count = bin_of(14)
    found = find_arrangement(count, BLOCK, (0.3, 0.4), workers=1)
    assert found.piles_compared == 2 and 12 <= found.pile_count <= 14
    assert 0 < len(found.T_world_parts) <= found.pile_count
    assert 0 < found.height_difference_m < INNER[2]
    # Every part lies within the bin, and no higher than what was seen over it.
    corners = np.concatenate([geometry.apply(T, found.part.vertices.astype(float))
                              for T in found.T_world_parts])
    assert (np.abs(corners[:, :2]) < np.array(INNER[:2]) / 2 + 1e-3).all()
    assert corners[:, 2].min() > FLOOR - 1e-3 and corners[:, 2].max() < FLOOR + INNER[2] + 0.01
    again = find_arrangement(count, BLOCK, (0.3, 0.4), workers=1)
    assert np.array_equal(found.T_world_parts, again.T_world_parts), "depends on the scan alone"


@pytest.mark.parametrize("count, said", [
    (bin_of(0), "0 parts were counted; expected 1 to some of this form"),
    (bin_of(1001), "1001 parts were counted; expected 1 to 1000"),
    (replace(bin_of(9), volume=replace(counted_bin().volume,
                                       container=Container("none", np.eye(4)))),
     "the scan shows a 'none'; expected an open container of known form"),
    (replace(bin_of(9), volume=replace(counted_bin().volume,
                                       container=Container("free", np.eye(4)))),
     "the scan shows a 'free'")])
def test_what_cannot_be_poured_is_refused(count, said):
    with pytest.raises(PartError, match=said):
        find_arrangement(count, BLOCK, None, workers=1)
