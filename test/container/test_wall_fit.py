# SPDX-License-Identifier: Apache-2.0
"""Fits of outlines and walls recover the shapes that their noisy points were drawn from."""

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter.container.wall_fit import (
    FacePoints,
    Thickness,
    find_face_points,
    fit_outline,
    fit_wall,
)
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.fusion.region import Region

NOISE, WALL, HEIGHT = 0.0005, 0.006, 0.12
TRUE = {"box": BoxWall(np.array([0.02, -0.03, 0.3, 0.3, 0.2, 0.12])),
        "round": RoundWall(np.array([0.02, -0.03, 0.1, 0.1, 0.5]))}
GUESS = {"box": BoxWall(np.array([0.022, -0.032, 0.31, 0.303, 0.198, 0.0])),
         "round": RoundWall(np.array([0.022, -0.032, 0.102, 0.0, 0.0]))}
TOLERANCE = {"box": [3e-4, 3e-4, 3e-3, 5e-4, 5e-4, 0.01],
             "round": [3e-4, 3e-4, 3e-4, 0.02, 0.3]}


def on_ring(shape, below, inwards, random):
    """One point of a ring for each depth, drawn evenly over the sides, with noise."""
    points = []
    for depth, moved in zip(below, inwards):
        ring = shape.ring(depth, moved)
        i, share = random.integers(len(ring)), random.uniform()
        points.append(ring[i] + share * (ring[(i + 1) % len(ring)] - ring[i]))
    return np.array(points) + random.normal(0, NOISE, (len(points), 2))


def faces(shape, count=20_000, hidden_below=HEIGHT):
    """Points of both faces; of the inner one only down to where parts hide it."""
    random = np.random.default_rng(1)
    below, inner = random.uniform(0.003, HEIGHT - 0.002, count), random.uniform(size=count) < 0.5
    below[inner] *= hidden_below / HEIGHT
    return FacePoints(on_ring(shape, below, WALL * inner, random), below, inner)


@pytest.mark.parametrize("kind", TRUE)
def test_an_outline_is_recovered_though_some_points_are_far_off(kind):
    random = np.random.default_rng(0)
    xy = on_ring(TRUE[kind], np.zeros(180), np.zeros(180), random)
    xy[::15] += random.uniform(-0.03, 0.03, (12, 2))
    got = fit_outline(GUESS[kind], xy, NOISE)
    sizes = slice(0, 5 if kind == "box" else 3)
    assert np.all(np.abs(got.params - TRUE[kind].params)[sizes]
                  < 1.5 * np.array(TOLERANCE[kind])[sizes])
    # The rim does not determine the draft: it stays as it was.
    assert got.params[sizes.stop:] == pytest.approx(GUESS[kind].params[sizes.stop:], abs=1e-6)


@pytest.mark.parametrize("kind", TRUE)
def test_a_wall_is_recovered_with_its_draft_and_thickness(kind):
    wall = fit_wall(GUESS[kind], faces(TRUE[kind]), HEIGHT, Thickness(0.004, 0.01), NOISE)
    assert np.all(np.abs(wall.shape.params - TRUE[kind].params) < TOLERANCE[kind])
    assert wall.thickness == pytest.approx(WALL, abs=2e-4)
    assert wall.outer_share > 0.95 and wall.inner_share > 0.95
    assert wall.spread < NOISE  # medians of many points


def test_parts_that_hide_the_inner_face_leave_the_outer_one():
    wall = fit_wall(GUESS["box"], faces(TRUE["box"], hidden_below=0.03), HEIGHT,
                    Thickness(0.004, 0.01), NOISE)
    assert np.all(np.abs(wall.shape.params - TRUE["box"].params) < TOLERANCE["box"])
    assert wall.thickness == pytest.approx(WALL, abs=4e-4)


def test_half_a_wall_is_seen_on_half_of_its_sectors():
    points = faces(TRUE["round"])
    half = points.select(points.xy[:, 0] > TRUE["round"].center[0])
    wall = fit_wall(GUESS["round"], half, HEIGHT, Thickness(WALL, 1e-6), NOISE)
    assert wall.outer_share == pytest.approx(0.5, abs=0.05)
    assert wall.best_face_share == max(wall.outer_share, wall.inner_share)


def test_no_point_gives_what_was_expected():
    nothing = FacePoints(np.zeros((0, 2)), np.zeros(0), np.zeros(0, bool))
    wall = fit_wall(GUESS["box"], nothing, HEIGHT, Thickness(0.005, 0.001), NOISE)
    assert wall.shape.params == pytest.approx(GUESS["box"].params, abs=1e-9)
    assert wall.thickness == pytest.approx(0.005) and wall.spread == np.inf


def test_views_show_the_near_wall_from_outside_and_the_far_one_from_inside():
    scene = Scene().bin((0.24, 0.16, 0.1), 0.008, 0.005, 0.02)
    outer = BoxWall(np.array([0, 0, 0, 0.256, 0.176, 0.0]))
    region = Region(np.array([-0.2, -0.2, -0.02]), np.array([0.2, 0.2, 0.2]), 0.0, 0.0005)
    points = find_face_points(scene.views(4, tilts=(45,)), region, outer, 0.105)
    assert points.below.min() > 0.003 and points.below.max() < 0.105
    distance = outer.depth_inside(points.xy, points.below)
    assert np.median(np.abs(distance[~points.inner])) < 1e-4
    # Beyond the wall's inside lie the filling and the floor too.
    on_wall = np.abs(distance[points.inner] - 0.008) < 5e-4
    assert on_wall.mean() > 0.3 and distance[points.inner].min() > 0.007
