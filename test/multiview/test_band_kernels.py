# SPDX-License-Identifier: Apache-2.0
"""The compiled loops against the same in plain NumPy."""

import cv2
import numpy as np
import pytest

from stack_counter.multiview.band_kernels import (
    Band,
    Neighbours,
    add_band_paths,
    match_band,
    pick_in_band,
)

SHAPE, PLANES, RADIUS, NOISE, COUNT = (9, 11), 7, 1, 2.0, 2
STEP_COST, JUMP_COST, EDGE_GREY = 20.0, 90.0, 8.0


def noise(seed, shape):
    """Smooth random grey levels."""
    random = np.random.default_rng(seed)
    return cv2.GaussianBlur(random.uniform(0, 255, shape).astype(np.float32), (0, 0), 1.0)


@pytest.fixture(scope="module")
def band():
    random = np.random.default_rng(1)
    return Band(random.integers(0, 6, SHAPE).astype(np.int32), PLANES,
                random.random(SHAPE) < 0.9,
                random.normal(0, 0.02, (*SHAPE, 2)).astype(np.float32), 1.5, 0.05)


@pytest.fixture(scope="module")
def neighbours():
    random = np.random.default_rng(2)
    sizes = np.array([[12, 14], [14, 13], [13, 12]], np.int32)
    greys = np.zeros((3, *sizes.max(axis=0)), np.float32)
    for i, (rows, cols) in enumerate(sizes):
        greys[i, :rows, :cols] = noise(i, (rows, cols))
    to_other = np.eye(3) + random.normal(0, 0.002, (3, 3, 3))
    return Neighbours(greys, sizes, to_other.astype(np.float32),
                      random.normal(0, 1.0, (3, 3)).astype(np.float32) * [1, 1, 0.01])


def sample(grey, x, y):
    """Bilinear grey levels of an image (h, w) at (x, y), which are moved into it."""
    h, w = grey.shape
    x, y = np.clip(x, 0, w - 1.001), np.clip(y, 0, h - 1.001)
    c, r = x.astype(int), y.astype(int)
    a, b = x - c, y - r
    return ((1 - a) * (1 - b) * grey[r, c] + a * (1 - b) * grey[r, c + 1]
            + (1 - a) * b * grey[r + 1, c] + a * b * grey[r + 1, c + 1])


def correlation(grey, neighbours, j, band, row, col, k):
    """Normalised cross-correlation of a window on a slanted plane, or none behind the camera."""
    dv, du = np.mgrid[-RADIUS:RADIUS + 1, -RADIUS:RADIUS + 1]
    rows, cols = (np.clip(at + d, 0, n - 1) for at, d, n in zip((row, col), (dv, du), SHAPE))
    window = grey[rows, cols].astype(float)
    # Map the middle exactly, and what is around it by numeric derivatives.
    slope = band.slopes[row, col]

    def project(u, v):
        inverse_depth = (band.far + band.step * (band.start[row, col] + k)
                         + slope[0] * (u - col) + slope[1] * (v - row))
        x, y, z = neighbours.to_other[j].astype(float) @ [u, v, 1] \
            + neighbours.shift[j] * inverse_depth
        return np.array([x / z, y / z])

    h = 1e-4
    middle = project(col, row)
    across = (project(col + h, row) - project(col - h, row)) / (2 * h)
    down = (project(col, row + h) - project(col, row - h)) / (2 * h)
    x, y = middle[:, None, None] + across[:, None, None] * du + down[:, None, None] * dv
    rows, cols = neighbours.sizes[j]
    other = sample(neighbours.greys[j][:rows, :cols].astype(float), x, y)
    covariance = np.mean(window * other) - window.mean() * other.mean()
    return covariance / np.sqrt((window.var() + NOISE**2) * (other.var() + NOISE**2))


def test_costs_are_those_of_the_better_half_of_the_correlations(band, neighbours):
    grey = noise(9, SHAPE)
    cost = match_band(grey, neighbours, band, RADIUS, NOISE, COUNT)
    assert (cost[~band.searched] == 255).all()
    for row, col in np.argwhere(band.searched):
        for k in range(PLANES):
            scores = [correlation(grey, neighbours, j, band, row, col, k) for j in range(3)]
            agreement = np.clip(np.mean(np.sort(scores)[-COUNT:]), 0, 1)
            assert cost[row, col, k] == pytest.approx(255 * (1 - agreement), abs=1.5)


def test_behind_a_camera_nothing_agrees(band, neighbours):
    grey = noise(9, SHAPE)
    behind = neighbours._replace(to_other=-neighbours.to_other, shift=-neighbours.shift)
    assert (match_band(grey, behind, band, RADIUS, NOISE, COUNT) == 255).all()
    no_depth = band._replace(far=-9.0)
    assert (match_band(grey, neighbours, no_depth, RADIUS, NOISE, COUNT) == 255).all()


def all_paths(cost, grey, start):
    """Summed costs of paths from eight sides; planes outside a pixel's band cost infinity."""
    height, width, planes = cost.shape
    count = start.max() + planes
    full = np.full((height, width, count), np.inf)
    for row, col in np.ndindex(height, width):
        full[row, col, start[row, col]:start[row, col] + planes] = cost[row, col]
    total = np.zeros(full.shape)
    for dr, dc in [(r, c) for r in (-1, 0, 1) for c in (-1, 0, 1) if r or c]:
        paths = np.full(full.shape, np.inf)
        for row in range(height)[::-1 if dr > 0 else 1]:
            for col in range(width)[::-1 if dc > 0 else 1]:
                r, c = row + dr, col + dc
                paths[row, col] = full[row, col]
                if 0 <= r < height and 0 <= c < width:
                    before = np.pad(paths[r, c], 1, constant_values=np.inf)
                    jump = max(JUMP_COST / (1 + abs(grey[row, col] - grey[r, c]) / EDGE_GREY),
                               STEP_COST)
                    paths[row, col] += np.minimum.reduce([
                        before[1:-1], before[:-2] + STEP_COST, before[2:] + STEP_COST,
                        np.full(count, before.min() + jump)]) - before.min()
        total += paths
    return np.array([[total[row, col, start[row, col]:start[row, col] + planes]
                      for col in range(width)] for row in range(height)])


def test_paths_come_from_eight_sides(band):
    cost = np.random.default_rng(3).integers(0, 256, (*SHAPE, PLANES)).astype(np.uint8)
    grey = noise(4, SHAPE)
    total = np.zeros(cost.shape, np.float32)
    for forwards in (True, False):
        add_band_paths(cost, grey, band.start, total, STEP_COST, JUMP_COST, EDGE_GREY, forwards)
    assert total == pytest.approx(all_paths(cost, grey, band.start), abs=0.01)


def test_a_clear_minimum_is_picked_between_planes():
    at = 3.3
    bowl = (10 + (np.arange(PLANES) - at)**2).astype(np.float32)
    slope = np.arange(10, 10 + PLANES, dtype=np.float32)  # ends at the band's edge
    double = np.where(np.isin(np.arange(PLANES), (1, 5)), 10, 20).astype(np.float32)
    total, start = np.stack([bowl, slope, double, bowl])[None], np.array([[4, 4, 4, 4]], np.int32)
    searched = np.array([[True, True, True, False]])
    position = pick_in_band(total, start, searched, 100, 0.02)
    assert position[0] == pytest.approx([4 + at, -1, -1, -1], abs=1e-4)
    assert pick_in_band(total, start, searched, 7, 0.02)[0, 0] == -1  # beyond all planes
