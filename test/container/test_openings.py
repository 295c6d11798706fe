# SPDX-License-Identifier: Apache-2.0
"""Openings in maps of walls drawn as formulas."""

import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.container.openings import find_openings, isolate_opening, several_containers
from stack_counter.fusion.region import Region
from stack_counter.types import HeightMap

PITCH, WALL, HIGH = 0.002, 0.004, 0.07
LOW = np.array([-0.2, -0.15])
REGION = Region(np.array([-0.2, -0.15, 0.28]), np.array([0.2, 0.15, 0.5]), 0.3, 0.001)
Y, X = np.mgrid[:150, :200] * PITCH + PITCH / 2 + LOW[[1, 0]][:, None, None]


def map_of(*things, ground=0.0):
    """A map of (x, y, half width, half length, fill) bins, highest wins."""
    heights = np.full(X.shape, ground, np.float32)
    for x, y, a, b, fill in things:
        out = np.maximum(np.abs(X - x) - a, np.abs(Y - y) - b)
        heights[out < WALL] = np.maximum(heights[out < WALL], HIGH)
        heights[out < 0] = fill
    T = geometry.pose(np.eye(3), np.append(LOW, REGION.plane_z))
    return HeightMap(T, PITCH, heights)


def centers(openings):
    return sorted(tuple(np.round((o.low + o.high) / 2, 3)) for o in openings)


def test_bins_that_share_walls_are_told_apart():
    openings = find_openings(map_of(*((x, 0, 0.048, 0.08, 0.01) for x in (-0.1, 0, 0.1))))
    assert centers(openings) == [(-0.1, 0.0), (0.0, 0.0), (0.1, 0.0)]
    for opening in openings:
        np.testing.assert_allclose(opening.high - opening.low, [0.104, 0.168], atol=0.008)
        assert opening.rim_height == pytest.approx(HIGH, abs=1e-3)
    message = str(several_containers(openings, REGION))
    assert message.startswith("3 containers; expected one, or a region of interest")
    assert message.count("roi_center_m: [") == message.count("roi_size_m: [") == 3
    assert message.index("roi_center_m: [-0.1") < message.index("roi_center_m: [0.1")


def test_one_bin_on_a_board_is_cut_out_and_one_on_the_plane_is_left():
    on_plane = map_of((0, 0, 0.08, 0.06, 0.03))
    [opening] = find_openings(on_plane)
    assert isolate_opening(on_plane, opening) is on_plane
    on_board = map_of((0, 0, 0.08, 0.06, 0.04), ground=0.03)
    alone = isolate_opening(on_board, find_openings(on_board)[0])
    kept = np.isfinite(alone.heights)
    assert kept[75, 100] and not kept[0, 0]
    beyond = np.maximum(np.abs(X) - 0.08, np.abs(Y) - 0.06) - WALL
    assert beyond[kept].max() < 3 * PITCH


def heap():
    heights = map_of().heights + np.clip(0.06 - np.hypot(X, Y) / 2, 0, None).astype(np.float32)
    return heights + 0.006 * (np.sin(X * 200) * np.cos(Y * 170)).astype(np.float32)


@pytest.mark.parametrize("heights", [
    heap(),                                         # no walls
    map_of((0, 0, 0.08, 0.06, HIGH - 0.004)).heights,  # full to the rim
    np.where(X > 0, map_of((0, 0, 0.08, 0.06, 0.02)).heights, 0),  # a wall is missing
    map_of((0, 0, 0.016, 0.016, 0.0)).heights,      # as narrow as a part's own hole
    np.where(np.hypot(X - 0.08, Y) < 0.06, HIGH, map_of((0, 0, 0.08, 0.06, 0.02)).heights),
], ids=["heap", "full", "three walls", "narrow", "half covered"])
def test_what_is_no_opening(heights):
    top = map_of()
    assert find_openings(HeightMap(top.T_world_map, PITCH, heights)) == []


def test_holes_of_parts_are_no_openings():
    frames = map_of((-0.08, 0, 0.03, 0.03, 0.0), (0.08, 0, 0.03, 0.03, 0.0))
    assert len(find_openings(frames)) == 2
    assert find_openings(frames, unit_volume=0.03**3) == []


def test_unseen_cells_and_noise_leave_an_opening():
    top = map_of((-0.06, 0, 0.05, 0.08, 0.01), (0.06, 0, 0.05, 0.08, 0.02))
    random = np.random.default_rng(0)
    heights = top.heights + random.normal(0, 0.0007, X.shape).astype(np.float32)
    heights[random.random(X.shape) < 0.05] = np.nan
    assert len(find_openings(HeightMap(top.T_world_map, PITCH, heights))) == 2
