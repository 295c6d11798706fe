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


def test_walls_are_as_inclined_as_the_floor_is_small():
    volume = counted_bin().volume
    heights = volume.inner.heights.copy()
    rows, cols = heights.shape
    sunk = 6  # cells of the map by which the floor is smaller all around
    heights[np.isfinite(heights)] = FLOOR + INNER[2]
    heights[sunk:rows - sunk, sunk:cols - sunk] = FLOOR
    made = _container_in_map(replace(volume, inner=replace(volume.inner, heights=heights)))
    inwards = sunk * volume.inner.pitch
    assert np.tan(made.draft_rad) == pytest.approx(inwards / INNER[2], rel=0.02)


def test_a_pile_is_compared_in_the_turns_that_leave_its_container_alike():
    made = _container_in_map(counted_bin().volume)
    x, y, depth = INNER
    for kind, size, turns in (("bin", INNER, 2), ("bin", (x, x, depth), 4), ("bag", INNER, 1),
                              ("cylinder", (x, x, depth), SETTINGS.round_turns)):
        scene = scene_of(replace(made, kind=kind, inner_size_m=size), (0.05, 0.0, 0.1))
        places = [turned.part_poses()[0, :3, 3] for turned in _alike_turns(scene)]
        assert len(places) == turns
        middle = made.T_world_container[:3, 3]
        assert np.ptp([np.linalg.norm(place - middle) for place in places]) < 1e-9
        if turns > 1:
            assert places[turns // 2][:2] - middle[:2] == pytest.approx([-0.05, 0.0], abs=1e-9)


def test_the_surface_of_a_pile_is_no_height_off_itself():
    volume = counted_bin().volume
    scene = scene_of(_container_in_map(volume), (0.05, 0.0, FLOOR + 0.02),
                     (-0.05, 0.03, FLOOR + 0.05))
    top = volume.top
    xy = (np.moveaxis(np.indices(top.heights.shape)[::-1], 0, -1) + 0.5) * top.pitch
    own = np.maximum(RayCaster(scene.parts_mesh()).surface_heights(xy), FLOOR)
    same = replace(top, heights=own.astype(np.float32))
    assert _height_difference(scene, same) == pytest.approx(0, abs=1e-6)
    higher = replace(same, heights=same.heights + np.float32(0.01))
    assert _height_difference(scene, higher) == pytest.approx(0.01, abs=1e-6)


def test_parts_that_stand_out_of_the_surface_are_left_out():
    made = _container_in_map(counted_bin().volume)
    level = HeightMap(np.eye(4), 0.005, np.full((40, 60), 0.05, np.float32))
    below, above = (0.0, 0.0, FLOOR + 0.02), (0.08, 0.0, FLOOR + 0.04)
    hidden = _hidden_poses(scene_of(made, below, above), level)
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
    (bin_of(0), "0 parts were counted; expected 1 to 1000 of this form"),
    (bin_of(1001), "1001 parts were counted; expected 1 to 1000"),
    (replace(bin_of(9), volume=replace(counted_bin().volume,
                                       container=Container("none", np.eye(4)))),
     "the scan shows a 'none'; expected an open container")])
def test_what_cannot_be_poured_is_refused(count, said):
    with pytest.raises(PartError, match=said):
        find_arrangement(count, BLOCK, None, workers=1)
