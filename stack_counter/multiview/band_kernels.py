# SPDX-License-Identifier: Apache-2.0
"""The loops of `fine_matching`, compiled by numba: costs in a band of planes, and paths in it."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import NamedTuple, TypeVar

import numba
import numpy as np

_Function = TypeVar("_Function", bound=Callable)
# Cost of a plane on which pictures do not agree at all.
_WORST = np.float32(255)
# Planes on either side of the best one that belong to its minimum.
_PEAK_PLANES = 2
# More than any cost or grey level; compiled with `fastmath`, infinity is not a number.
_HUGE = np.float32(1e30)


class Neighbours(NamedTuple):
    """Pictures that one is compared with.

    Attributes:
        greys: (n, h, w) float32 grey levels, each from the upper left on.
        sizes: (n, 2) int32 their heights and widths.
        to_other: (n, 3, 3) float32 maps homogeneous pixels to theirs for points at infinity.
        shift: (n, 3) float32 what is added to that for each 1/m of inverse depth.
    """

    greys: np.ndarray
    sizes: np.ndarray
    to_other: np.ndarray
    shift: np.ndarray


class Band(NamedTuple):
    """The planes that are tried at each pixel.

    Attributes:
        start: (h, w) int32 the first of them among all planes.
        planes: their number.
        searched: (h, w) bool, pixels that get depth.
        slopes: (h, w, 2) float32 derivatives of their inverse depth along columns and rows, 1/m a
            pixel.
        far, step: inverse depth of the farthest of all planes, and from one to the next, 1/m.
    """

    start: np.ndarray
    planes: int
    searched: np.ndarray
    slopes: np.ndarray
    far: float
    step: float


def _compiled(function: _Function) -> _Function:
    """Compiles a function; it runs without the interpreter's lock, and is kept for later runs."""
    compiled = partial(numba.njit, nogil=True, fastmath=True, error_model="numpy")
    try:
        return compiled(cache=True)(function)
    except RuntimeError:  # no folder to keep it in: every process compiles anew
        return compiled()(function)


@_compiled
def match_band(grey: np.ndarray, neighbours: Neighbours, band: Band, radius: int, noise: float,
               count: int) -> np.ndarray:
    """Compares windows of a picture with its neighbours on every plane of the band.

    Args:
        grey: (h, w) float32 the reference.
        neighbours: what it is compared with.
        band: the planes.
        radius: of the square window, pixels.
        noise: standard deviation of a grey level that is noise.
        count: number of the neighbours that must agree.

    Returns:
        (h, w, planes) uint8 costs: 0 for pictures that agree, 255 for a normalised
        cross-correlation of 0 or below.
    """
    height, width = grey.shape
    cost = np.full((height, width, band.planes), _WORST, np.uint8)
    window = np.zeros((2 * radius + 1, 2 * radius + 1), np.float32)
    best = np.zeros((band.planes, count), np.float32)  # correlations, best first
    noise_variance = np.float32(noise * noise)
    for row in range(height):
        for col in range(width):
            if not band.searched[row, col]:
                continue
            variance = _take_window(grey, row, col, window) + noise_variance
            best[:] = -1
            for j in range(len(neighbours.greys)):
                for k in range(band.planes):
                    inverse_depth = np.float32(band.far + band.step * (band.start[row, col] + k))
                    score = _correlate(
                        window, neighbours.greys[j], neighbours.sizes[j], neighbours.to_other[j],
                        neighbours.shift[j], np.float32(col), np.float32(row), inverse_depth,
                        band.slopes[row, col], noise_variance) / np.sqrt(variance)
                    for rank in range(count):
                        if score > best[k, rank]:
                            best[k, rank], score = score, best[k, rank]
            for k in range(band.planes):
                agreement = min(max(best[k].mean(), np.float32(0)), np.float32(1))
                cost[row, col, k] = np.uint8((1 - agreement) * _WORST)
    return cost


@_compiled
def _take_window(grey: np.ndarray, row: int, col: int, window: np.ndarray) -> float:
    """Writes a window of grey levels, from their mean and over their number.

    Args:
        grey: (h, w) float32.
        row, col: its middle.
        window: (side, side) float32, written.

    Returns:
        Variance of the grey levels.
    """
    height, width = grey.shape
    side = len(window)
    mean, variance = np.float32(0), np.float32(0)
    for i in range(side):
        for j in range(side):
            window[i, j] = grey[min(max(row + i - side // 2, 0), height - 1),
                                min(max(col + j - side // 2, 0), width - 1)]
            mean += window[i, j]
    share = np.float32(1 / (side * side))
    mean *= share
    for i in range(side):
        for j in range(side):
            level = window[i, j] - mean
            variance += level * level * share
            window[i, j] = level * share
    return variance


@_compiled
def _correlate(window: np.ndarray, grey: np.ndarray, size: np.ndarray, M: np.ndarray,
               m: np.ndarray, u: float, v: float, inverse_depth: float, slope: np.ndarray,
               noise_variance: float) -> float:
    """Covariance of a window and another picture on a plane, over the latter's deviation.

    Args:
        window: (side, side) float32 of `_take_window`.
        grey, size, M, m: one of `Neighbours`.
        u, v: column and row of the window's middle.
        inverse_depth: of the plane there, 1/m.
        slope: (2,) its derivatives along columns and rows.
        noise_variance: added to the variance.

    Returns:
        In grey levels; -1e30 behind the other camera.
    """
    # Where the middle of the window falls, and how the window is warped there.
    z = M[2, 0] * u + M[2, 1] * v + M[2, 2] + m[2] * inverse_depth
    if inverse_depth <= 0 or z <= 0:
        return -_HUGE
    x = (M[0, 0] * u + M[0, 1] * v + M[0, 2] + m[0] * inverse_depth) / z
    y = (M[1, 0] * u + M[1, 1] * v + M[1, 2] + m[1] * inverse_depth) / z
    z_u, z_v = M[2, 0] + m[2] * slope[0], M[2, 1] + m[2] * slope[1]
    x_u, x_v = (M[0, 0] + m[0] * slope[0] - x * z_u) / z, (M[0, 1] + m[0] * slope[1] - x * z_v) / z
    y_u, y_v = (M[1, 0] + m[1] * slope[0] - y * z_u) / z, (M[1, 1] + m[1] * slope[1] - y * z_v) / z
    last_x, last_y = np.float32(size[1] - 1.001), np.float32(size[0] - 1.001)
    # Sums over the samples, each between four pixels.
    side = len(window)
    mean, square, product = np.float32(0), np.float32(0), np.float32(0)
    for i in range(side):
        for j in range(side):
            du, dv = np.float32(j - side // 2), np.float32(i - side // 2)
            px = min(max(x + x_u * du + x_v * dv, np.float32(0)), last_x)
            py = min(max(y + y_u * du + y_v * dv, np.float32(0)), last_y)
            c, r = int(px), int(py)
            across, down = px - np.float32(c), py - np.float32(r)
            upper = grey[r, c] + across * (grey[r, c + 1] - grey[r, c])
            lower = grey[r + 1, c] + across * (grey[r + 1, c + 1] - grey[r + 1, c])
            level = upper + down * (lower - upper)
            mean += level
            square += level * level
            product += window[i, j] * level
    share = np.float32(1 / (side * side))
    variance = max(square * share - mean * mean * share * share, np.float32(0)) + noise_variance
    return product / np.sqrt(variance)


@_compiled
def add_band_paths(cost: np.ndarray, grey: np.ndarray, start: np.ndarray, total: np.ndarray,
                   step_cost: float, jump_cost: float, edge_grey: float, forwards: bool) -> None:
    """Adds the costs of the cheapest paths from the left and from the three pixels above.

    Args:
        cost: (h, w, planes) uint8.
        grey: (h, w) float32; a jump of depth costs less where its levels jump.
        start: (h, w) int32 first plane of each pixel's band.
        total: (h, w, planes) float32, added to.
        step_cost, jump_cost: costs of a step by one plane, and of a larger jump.
        edge_grey: difference of grey levels that halves the cost of a jump.
        forwards: as said; else all is turned by 180 degrees: from the right and from below.
    """
    height, width, planes = cost.shape
    # Costs of the paths to the pixels of the row above and of this one, by direction.
    above = np.zeros((3, width, planes), np.float32)
    here = np.zeros((3, width, planes), np.float32)
    left = np.zeros(planes, np.float32)
    path = np.zeros(planes, np.float32)
    sign = 1 if forwards else -1
    for i in range(height):
        row = i if forwards else height - 1 - i
        for j in range(width):
            col = j if forwards else width - 1 - j
            for way in range(4):  # from the left, from above left, above, above right
                r, c = (row, col - sign) if way == 0 else (row - sign, col + sign * (way - 2))
                if r < 0 or r >= height or c < 0 or c >= width:
                    for k in range(planes):
                        path[k] = cost[row, col, k]
                else:
                    jump = max(jump_cost / (1 + abs(grey[row, col] - grey[r, c]) / edge_grey),
                               step_cost)
                    _extend_path(cost[row, col], left if way == 0 else above[way - 1, c],
                                 start[row, col] - start[r, c], np.float32(step_cost),
                                 np.float32(jump), path)
                for k in range(planes):
                    total[row, col, k] += path[k]
                    if way == 0:
                        left[k] = path[k]
                    else:
                        here[way - 1, col, k] = path[k]
        above, here = here, above


@_compiled
def _extend_path(cost: np.ndarray, before: np.ndarray, offset: int, step_cost: float,
                 jump_cost: float, path: np.ndarray) -> None:
    """Writes the (planes,) costs of the cheapest paths by the next pixel into `path`.

    `before` are those to the pixel before, whose band begins `offset` planes lower.
    """
    planes = len(cost)
    lowest = before[0]
    for k in range(1, planes):
        lowest = min(lowest, before[k])
    for k in range(planes):
        there = k + offset
        cheapest = lowest + jump_cost
        if 0 <= there < planes:
            cheapest = min(cheapest, before[there])
        if 0 <= there - 1 < planes:
            cheapest = min(cheapest, before[there - 1] + step_cost)
        if 0 <= there + 1 < planes:
            cheapest = min(cheapest, before[there + 1] + step_cost)
        path[k] = np.float32(cost[k]) + cheapest - lowest


@_compiled
def pick_in_band(total: np.ndarray, start: np.ndarray, searched: np.ndarray, count: int,
                 min_margin: float) -> np.ndarray:
    """Returns (h, w) float32 positions of the clear minima among all planes; -1 elsewhere.

    Args:
        total: (h, w, planes) float32 costs.
        start: (h, w) int32 first plane of each pixel's band.
        searched: (h, w) bool.
        count: number of all planes.
        min_margin: share by which the second best minimum must cost more.
    """
    height, width, planes = total.shape
    position = np.full((height, width), -1, np.float32)
    for row in range(height):
        for col in range(width):
            if not searched[row, col]:
                continue
            costs = total[row, col]
            k = np.argmin(costs)
            second = _HUGE
            for i in range(planes):
                if abs(i - k) > _PEAK_PLANES:
                    second = min(second, costs[i])
            if k == 0 or k == planes - 1 or second < (1 + min_margin) * costs[k]:
                continue
            bend = costs[k - 1] - 2 * costs[k] + costs[k + 1]
            offset = (costs[k - 1] - costs[k + 1]) / (2 * bend) if bend > 0 else np.float32(0)
            at = start[row, col] + k + min(max(offset, np.float32(-0.5)), np.float32(0.5))
            if 0 <= at <= count - 1:
                position[row, col] = at
    return position
