# SPDX-License-Identifier: Apache-2.0
"""Rims in height maps of closed forms: found to within a cell of the map."""

import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.container.rim import (
    find_rim,
    find_rim_points,
    measure_outline_share,
    measure_rim_height,
)
from stack_counter.container.wall_shapes import BoxWall, RoundWall
from stack_counter.types import HeightMap

HEIGHT, FLOOR, WALL, LOWEST = 0.1, 0.03, 0.008, 0.006
BOX = BoxWall(np.array([0.02, -0.01, 0.3, 0.26, 0.18, 0.0]))
ROUND = RoundWall(np.array([-0.02, 0.01, 0.11, 0.0, 0.0]))


def height_map(pitch, height_at):
    """Map 0.4 m wide whose heights are a function of (rows, cols, 2) world places."""
    n = int(0.4 / pitch)
    rows, cols = np.mgrid[:n, :n]
    xy = (np.stack([cols, rows], axis=-1) + 0.5) * pitch - 0.2
    T = geometry.pose(np.eye(3), np.array([-0.2, -0.2, 0.0]))
    return HeightMap(T, pitch, height_at(xy).astype(np.float32))


def bin_map(shape, pitch, filling=FLOOR, wall=WALL):
    """A bin with upright walls on the plane, filled flat."""
    def height_at(xy):
        inside = shape.depth_inside(xy.reshape(-1, 2), np.zeros(xy[..., 0].size))
        inside = inside.reshape(xy.shape[:2])
        return np.where(inside < 0, 0.0, np.where(inside < wall, HEIGHT, filling))
    return height_map(pitch, height_at)


def distance(a, b):
    """Largest distance between two outlines, metres."""
    ring = b.ring(0.0, 0.0)
    return np.abs(a.depth_inside(ring, np.zeros(len(ring)))).max()


@pytest.mark.parametrize("shape", [BOX, ROUND], ids=lambda s: s.kind)
@pytest.mark.parametrize("pitch", [0.001, 0.002])
def test_the_rim_of_a_bin_is_found_to_within_a_cell(shape, pitch):
    rim = find_rim(bin_map(shape, pitch), LOWEST, "auto")
    assert rim.outline.kind == shape.kind
    assert rim.height == pytest.approx(HEIGHT, abs=1e-6)
    assert distance(rim.outline, shape) < pitch
    assert rim.width == pytest.approx(WALL, abs=pitch)
    assert rim.outline_share > 0.97 and rim.inner_drop_share > 0.97


@pytest.mark.parametrize("kind", ["box", "round"])
def test_only_the_kind_that_is_asked_for_is_tried(kind):
    rim = find_rim(bin_map(BOX, 0.002), LOWEST, kind)
    assert rim.outline.kind == kind
    assert (rim.outline_share > 0.9) == (kind == "box")


def test_an_outline_that_is_neither_is_free():
    """A rounded triangle: its radius changes with three times the angle."""
    def height_at(xy):
        r, angle = np.hypot(*np.moveaxis(xy, -1, 0)), np.arctan2(xy[..., 1], xy[..., 0])
        inside = 0.12 + 0.012 * np.cos(3 * angle) - r
        return np.where(inside < 0, 0.0, np.where(inside < WALL, HEIGHT, FLOOR))
    rim = find_rim(height_map(0.001, height_at), LOWEST, "auto")
    assert rim.outline.kind == "free" and rim.outline_share > 0.95
    radii = rim.outline.params
    assert radii[0] == pytest.approx(0.12, abs=0.001)
    assert np.hypot(radii[3], radii[11]) == pytest.approx(0.012, abs=0.001)


def test_what_is_filled_to_the_rim_has_neither_width_nor_fall():
    rim = find_rim(bin_map(BOX, 0.001, filling=HEIGHT), LOWEST, "box")
    assert np.isnan(rim.width) and rim.inner_drop_share == 0
    assert distance(rim.outline, BOX) < 0.001


def test_a_cone_has_no_rim_worth_the_name():
    cone = height_map(0.001, lambda xy: np.maximum(0.1 - np.linalg.norm(xy, axis=-1), 0))
    rim = find_rim(cone, LOWEST, "auto")
    assert rim is None or rim.height < 0.02  # its foot, level with what is hardly looked at


def test_nothing_standing_has_no_rim():
    assert find_rim(height_map(0.002, lambda xy: np.zeros(xy.shape[:2])), LOWEST, "auto") is None
    points = find_rim_points(height_map(0.002, lambda xy: np.full(xy.shape[:2], np.nan)), LOWEST)
    assert points.xy.shape == (0, 2)


def test_points_lie_on_the_outline_one_in_a_sector():
    top = bin_map(ROUND, 0.001)
    points = find_rim_points(top, LOWEST)
    assert 170 <= len(points.xy) <= 180
    np.testing.assert_allclose(points.center, ROUND.center, atol=0.001)
    np.testing.assert_allclose(np.linalg.norm(points.xy - ROUND.center, axis=1), 0.11,
                               atol=0.001)
    assert measure_outline_share(ROUND, points.xy, top.pitch) == len(points.xy) / 180
    assert measure_outline_share(ROUND.offset_inwards(0.01), points.xy, top.pitch) == 0


def test_the_height_of_a_rim_whose_outline_is_given():
    top = bin_map(BOX, 0.002)
    assert measure_rim_height(top, BOX, WALL, HEIGHT + 0.002) == pytest.approx(HEIGHT, abs=1e-6)
    assert measure_rim_height(top, BOX, WALL, 0.2) == 0.2  # nothing is there: as expected before
