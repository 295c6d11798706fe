# SPDX-License-Identifier: Apache-2.0
"""Few convex pieces from many: of two that touch, those whose common hull adds least."""

from __future__ import annotations

import heapq
from dataclasses import dataclass

import numpy as np
from scipy.spatial import ConvexHull, QhullError

# Distance up to which two pieces touch, over the part size: cuts are exact to 1e-6. Chosen.
_TOUCH = 1e-3


@dataclass(frozen=True, eq=False)
class _Hull:
    """A convex piece: its corners (n, 3), volume, and bounding box."""

    corners: np.ndarray
    volume: float
    low: np.ndarray
    high: np.ndarray

    def touches(self, other: _Hull, gap: float) -> bool:
        """Whether the bounding boxes are less than a gap apart."""
        return bool((self.low <= other.high + gap).all() and (other.low <= self.high + gap).all())


def merge_pieces(pieces: list[np.ndarray], most: int) -> list[np.ndarray]:
    """Corners (n, 3) of the hulls of the pieces, merged until they are no more than `most`.

    Greedy: each time the two whose common hull adds the least volume. Flat pieces are left out.
    """
    hulls = {i: hull for i, hull in enumerate(map(_make_hull, pieces)) if hull is not None}
    if len(hulls) <= most:
        return [hull.corners for hull in hulls.values()]
    gap = _TOUCH * float(np.ptp(np.vstack(pieces), axis=0).max())
    pairs: list[tuple[float, int, int, _Hull]] = []
    numbers = list(hulls)
    for i, first in enumerate(numbers):
        _add_pairs(pairs, hulls, first, numbers[i + 1:], gap)
    number = len(pieces)
    while len(hulls) > most and pairs:
        _, first, second, common = heapq.heappop(pairs)
        if first in hulls and second in hulls:
            del hulls[first], hulls[second]
            hulls[number] = common
            _add_pairs(pairs, hulls, number, [other for other in hulls if other != number], gap)
            number += 1
    return [hull.corners for hull in hulls.values()]


def _add_pairs(pairs: list[tuple[float, int, int, _Hull]], hulls: dict[int, _Hull], number: int,
               others: list[int], gap: float) -> None:
    """Puts a piece's touching pairs on the heap, by the volume that their common hull adds."""
    hull = hulls[number]
    for other in others:
        if hull.touches(hulls[other], gap):
            common = _make_hull(np.vstack([hull.corners, hulls[other].corners]))
            if common is not None:
                added = common.volume - hull.volume - hulls[other].volume
                heapq.heappush(pairs, (added, number, other, common))


def _make_hull(points: np.ndarray) -> _Hull | None:
    """The hull of points (n, 3); None if they are flat."""
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):  # ValueError: fewer than four points
        return None
    corners = points[hull.vertices]
    return _Hull(corners, float(hull.volume), corners.min(axis=0), corners.max(axis=0))
