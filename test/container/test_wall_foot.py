# SPDX-License-Identifier: Apache-2.0
"""Walls that end above their underside, or go on as another container's below it."""

import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.container.wall_fit import FacePoints, FittedWall
from stack_counter.container.wall_foot import reaches_base
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.fusion.region import Region
from stack_counter.types import HeightMap

WALL = 0.004
REGION = Region(np.array([-0.15, -0.15, -0.04]), np.array([0.15, 0.15, 0.14]), 0.0, 1e-3)


def ground(height=0.0):
    """A map of the region in which all is level."""
    return HeightMap(geometry.pose(np.eye(3), np.array([-0.15, -0.15, 0.0])), 0.002,
                     np.full((150, 150), height, np.float32))


@pytest.mark.parametrize("kind, lowest, sides, base, beside, want", [
    ("box", 0.002, 2, 0.0, 0.0, True), ("box", 0.03, 2, 0.0, 0.0, False),
    ("box", 0.03, 1, 0.0, 0.0, True), ("box", 0.03, 2, 0.028, 0.028, True),
    ("round", 0.03, 2, 0.0, 0.0, True), ("box", 0.03, 0, 0.0, 0.0, True),
    ("box", 0.03, 2, 0.0, 0.06, True), ("box", 0.03, 2, 0.0, np.nan, True)])
def test_a_box_two_of_whose_sides_end_above_its_underside_is_noticed(kind, lowest, sides, base,
                                                                     beside, want):
    """Unless other things stand right beside these sides, or nobody sees what does."""
    rim, shape = 0.1, BoxWall(np.array([0, 0, 0, 0.2, 0.2, 0.0]))
    if kind == "round":
        shape = RoundWall(np.array([0, 0, 0.1, 0.0, 0.0]))
    z = np.repeat(np.arange(lowest, 0.097, 0.001), 8)
    places = np.array([[0.1, 0.0], [-0.1, 0.0]])[:sides]
    xy, z = np.repeat(places, len(z), axis=0), np.tile(z, sides)
    points = FacePoints(xy, rim - z, np.zeros(len(z), bool))
    assert reaches_base(ground(beside), [], FittedWall(shape, WALL), points, rim, base,
                        REGION) == want


@pytest.mark.parametrize("steps, base, beside, want", [
    ([], 0.0, 0.0, True), ([(0.05, 0.001)], 0.0, 0.0, False), ([(0.05, -0.001)], 0.0, 0.0, True),
    ([(0.05, 0.0004)], 0.0, 0.0, True), ([(0.07, 0.002), (0.05, -0.002)], 0.0, 0.0, True),
    ([(0.07, -0.002), (0.05, 0.002)], 0.0, 0.0, True), ([(0.05, 0.001)], 0.05, 0.05, True),
    ([(0.05, 0.001)], 0.0, 0.06, True)],
    ids=["straight", "ledge", "lip", "small", "rib", "groove", "below the underside",
         "other things beside it"])
def test_a_wall_that_begins_with_a_ledge_is_another_ones(steps, base, beside, want):
    """Steps, outwards, on the way down from a drafted round wall's rim; the fit goes between."""
    random, rim = np.random.default_rng(0), 0.1
    angle, z = random.uniform(-np.pi, np.pi, 8000), random.uniform(0.002, 0.097, 8000)
    radius = 0.1 - 0.05 * (rim - z) + sum(step * (z < height) for height, step in steps) \
        + random.normal(0, 1e-3, len(z))
    xy = radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    points = FacePoints(xy, rim - z, np.zeros(len(z), bool))
    wall = FittedWall(RoundWall(np.array([0, 0, 0.1, 0.05, 0.0])), WALL)
    assert reaches_base(ground(beside), [], wall, points, rim, base, REGION) == want
