# SPDX-License-Identifier: Apache-2.0
"""Photometric plane sweep of one view: how well its neighbours' pictures agree at every depth.

Source: Collins, "A space-sweep approach to true multi-image matching" (1996); costs are
aggregated along paths as in Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual
Information" (2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from stack_counter import geometry

# Cost of a plane on which pictures do not agree at all.
WORST = 255
_FORBIDDEN = np.iinfo(np.uint16).max
# Pixels along a line by which paths move from one line to the next: straight and diagonal.
_PATH_SHIFTS = (0, 1, -1)


@dataclass(frozen=True)
class PlaneSweepSettings:
    """How pictures are compared; all chosen.

    Attributes:
        grey_noise: standard deviation of a grey level that is noise; windows with less texture
            do not correlate.
        edge_grey: difference of grey levels between neighbours that halves the cost of a jump in
            depth between them.
        peak_planes: planes on either side of the best one that belong to its minimum.
    """

    grey_noise: float = 2.0
    edge_grey: float = 8.0
    peak_planes: int = 2


SETTINGS = PlaneSweepSettings()


@dataclass(frozen=True, eq=False)
class Picture:
    """What is matched.

    Attributes:
        grey: (h, w) float32 grey levels.
        K: (3, 3) float64 camera matrix, pixels.
        T_world_camera: (4, 4) float64 pose of the optical frame.
    """

    grey: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray


def sweep_planes(picture: Picture, neighbours: Sequence[Picture], inverse_depths: np.ndarray,
                 allowed: np.ndarray, radius: int) -> np.ndarray:
    """Returns the cost of planes across the optical axis: how little the neighbours agree there.

    Neighbours that do not see a surface are outvoted: only the better half of them counts.

    Args:
        picture: the reference.
        neighbours: pictures of the same surface from elsewhere; one or more.
        inverse_depths: (d,) float, 1/m.
        allowed: (d, h, w) bool, the planes that a pixel may take.
        radius: of the square window, pixels.

    Returns:
        (d, h, w) uint8: 0 for pictures that agree, `WORST` for a normalised cross-correlation of
        0 or below, which is also that of places without texture, and where not allowed.
    """
    mean, variance = _moments(picture.grey, radius)
    cost = np.full(allowed.shape, WORST, np.uint8)
    for i, inverse_depth in enumerate(inverse_depths):
        if not allowed[i].any():
            continue
        # Crop to what the plane is allowed in.
        box, inner = _bounding_box(allowed[i], radius)
        K = picture.K.copy()
        K[:2, 2] -= box[1].start, box[0].start
        part = Picture(picture.grey[box], K, picture.T_world_camera)
        # Correlate it with every neighbour, warped onto the plane.
        best = _mean_of_best_half([
            _correlate(part.grey, mean[box], variance[box],
                       _warp_by_plane(part, neighbour, inverse_depth), radius)[inner]
            for neighbour in neighbours])
        # Turn correlations into costs.
        here = tuple(slice(b.start + a.start, b.start + a.stop) for a, b in zip(inner, box))
        cost[i][here] = np.where(allowed[i][here], np.clip(1 - best, 0, 1) * WORST, WORST)
    return cost


def _bounding_box(mask: np.ndarray, margin: int
                  ) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """Returns the rows and columns that hold all of a mask.

    Args:
        mask: (h, w) bool, some of it True.
        margin: pixels that are added on every side, inside the image.

    Returns:
        The box with the margin; and, relative to it, the box without.
    """
    outer, inner = [], []
    for axis in (1, 0):
        where = np.nonzero(mask.any(axis=axis))[0]
        first, last = int(where[0]), int(where[-1]) + 1
        start = max(first - margin, 0)
        outer.append(slice(start, last + margin))
        inner.append(slice(first - start, last - start))
    return (outer[0], outer[1]), (inner[0], inner[1])


def _mean_of_best_half(scores: list[np.ndarray]) -> np.ndarray:
    """Returns the mean of the higher half of some images, pixel by pixel."""
    top: list[np.ndarray] = []  # sorted, best first
    for score in scores:
        for rank in range(len(top)):
            top[rank], score = np.maximum(top[rank], score), np.minimum(top[rank], score)
        if len(top) < (len(scores) + 1) // 2:
            top.append(score)
    return np.mean(top, axis=0)


def _moments(grey: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """Returns (h, w) float32 mean and variance in the windows around all pixels."""
    side = (2 * radius + 1,) * 2
    mean = cv2.blur(grey, side)
    return mean, np.maximum(cv2.blur(grey * grey, side) - mean * mean, 0) + SETTINGS.grey_noise**2


def _correlate(grey: np.ndarray, mean: np.ndarray, variance: np.ndarray, other: np.ndarray,
               radius: int) -> np.ndarray:
    """Returns the normalised cross-correlation of two pictures in the windows around all pixels.

    Args:
        grey: (h, w) float32.
        mean, variance: its `_moments`.
        other: (h, w) float32.
        radius: of the windows, pixels.

    Returns:
        (h, w) float32, -1 to 1.
    """
    other_mean, other_variance = _moments(other, radius)
    covariance = cv2.blur(grey * other, (2 * radius + 1,) * 2) - mean * other_mean
    return covariance / np.sqrt(variance * other_variance)


def _warp_by_plane(picture: Picture, neighbour: Picture, inverse_depth: float) -> np.ndarray:
    """Returns (h, w) float32 grey levels of the neighbour, as seen on a plane by the reference."""
    T_neighbour_camera = geometry.inverse(neighbour.T_world_camera) @ picture.T_world_camera
    on_plane = T_neighbour_camera[:3, :3] + np.outer(T_neighbour_camera[:3, 3],
                                                     [0, 0, inverse_depth])
    homography = neighbour.K @ on_plane @ np.linalg.inv(picture.K)
    return cv2.warpPerspective(neighbour.grey, homography, picture.grey.shape[::-1],
                               flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                               borderMode=cv2.BORDER_REPLICATE)


def aggregate_paths(cost: np.ndarray, grey: np.ndarray, step_cost: int, jump_cost: int
                    ) -> np.ndarray:
    """Sums the costs of the cheapest paths to every pixel and plane from eight sides.

    Args:
        cost: (d, h, w) uint8.
        grey: (h, w) float32 grey levels; a jump of depth costs less where they jump.
        step_cost: cost of a step by one plane.
        jump_cost: cost of a larger jump in an even region.

    Returns:
        (d, h, w) uint16.
    """
    total = np.zeros(cost.shape, np.uint16)
    for along_rows in (False, True):  # diagonal paths go with those along columns
        axes = (2, 0, 1) if along_rows else (1, 0, 2)  # (d, h, w) -> (lines, d, across)
        lines = np.ascontiguousarray(cost.transpose(axes)).astype(np.uint16)
        picture = grey.T if along_rows else grey
        out = np.zeros_like(lines)
        for shift in _PATH_SHIFTS[:1] if along_rows else _PATH_SHIFTS:
            for direction in (1, -1):
                _add_paths(lines[::direction], picture[::direction], shift, out[::direction],
                           step_cost, jump_cost)
        total += out.transpose(np.argsort(axes))
    return total


def _add_paths(lines: np.ndarray, grey: np.ndarray, shift: int, out: np.ndarray, step_cost: int,
               jump_cost: int) -> None:
    """Adds the costs of the cheapest paths from the first line on.

    Args:
        lines: (n, d, m) uint16 cost of n lines of m pixels.
        grey: (n, m) float32 grey levels.
        shift: by how many pixels a path moves along the line from one line to the next.
        out: (n, d, m) uint16, added to.
        step_cost: cost of a step by one plane.
        jump_cost: cost of a larger jump in an even region.
    """
    n, planes, width = lines.shape
    here, there = slice(max(shift, 0), width + min(shift, 0)), slice(
        max(-shift, 0), width - max(shift, 0))
    previous = lines[0].copy()
    out[0] += previous
    padded = np.full((planes + 2, width), _FORBIDDEN, np.uint16)
    for i in range(1, n):
        # A jump costs less across an edge of the picture.
        edge = np.abs(grey[i, here] - grey[i - 1, there])
        jump = np.maximum(jump_cost / (1 + edge / SETTINGS.edge_grey),
                          step_cost).astype(np.uint16)
        # Take the cheapest of staying on the plane, a step, and a jump from the best plane.
        old = previous[:, there]
        lowest = old.min(axis=0)
        ends = padded[:, here]
        np.add(old, np.uint16(step_cost), out=ends[1:-1])
        cheapest = np.minimum(ends[:-2], ends[2:])
        np.minimum(cheapest, old, out=cheapest)
        np.minimum(cheapest, lowest + jump, out=cheapest)
        cheapest -= lowest  # or costs would grow without end
        current = lines[i].copy()
        current[:, here] += cheapest
        out[i] += current
        previous = current


class BestPlanes(NamedTuple):
    """The cheapest plane of every pixel.

    Attributes:
        position: (h, w) float32 among the planes, between two of them by a parabola; -1 where
            none is allowed.
        margin: (h, w) float32 share by which the second best plane, not next to the best, costs
            more; 0 where none is allowed.
    """

    position: np.ndarray
    margin: np.ndarray


def find_best_planes(total: np.ndarray, allowed: np.ndarray) -> BestPlanes:
    """Finds the cheapest plane of every pixel.

    Args:
        total: (d, h, w) uint16 cost.
        allowed: (d, h, w) bool, the planes that a pixel may take.
    """
    # Take the cheapest plane.
    cost = np.where(allowed, total, _FORBIDDEN)
    index = np.argmin(cost, axis=0)
    planes = len(total)

    def cost_at(shift: int) -> np.ndarray:
        place = np.clip(index + shift, 0, planes - 1)
        return np.take_along_axis(total, place[None], axis=0)[0].astype(np.float32)

    # Fit a parabola through it and its neighbours.
    low, middle, high = cost_at(-1), cost_at(0), cost_at(1)
    bend = low - 2 * middle + high
    inside = (index > 0) & (index < planes - 1) & (bend > 0)
    offset = np.where(inside, (low - high) / np.maximum(2 * bend, 1), 0)
    # Find the second best minimum.
    for shift in range(-SETTINGS.peak_planes, SETTINGS.peak_planes + 1):
        np.put_along_axis(cost, np.clip(index + shift, 0, planes - 1)[None], _FORBIDDEN, axis=0)
    second = cost.min(axis=0).astype(np.float32)
    searched = allowed.any(axis=0)
    margin = np.where(searched, second / np.maximum(middle, 1) - 1, 0)
    position = np.where(searched, index + np.clip(offset, -0.5, 0.5), -1)
    return BestPlanes(position.astype(np.float32), margin.astype(np.float32))
