"""Photometric plane sweep of one view: how well its neighbours' pictures agree at every depth.

Source: Collins, "A space-sweep approach to true multi-image matching" (1996); costs are
aggregated along paths as in Hirschmueller, "Stereo Processing by Semiglobal Matching and Mutual
Information" (2008).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry

WORST = 255  # cost of a plane without any agreement
_GREY_NOISE = 2.0  # standard deviation of a grey level that is noise
_FORBIDDEN = np.iinfo(np.uint16).max
_SHIFTS = (0, 1, -1)  # pixels along a line that a path moves from line to line


@dataclass(frozen=True)
class Picture:
    """What is matched: (h, w) float32 grey levels, (3, 3) camera matrix in pixels, (4, 4) pose of
    the optical frame in the world."""

    grey: np.ndarray
    K: np.ndarray
    T_world_camera: np.ndarray


def sweep(picture: Picture, neighbours: Sequence[Picture], inverse_depths: np.ndarray,
          allowed: np.ndarray, radius: int) -> np.ndarray:
    """Cost of planes across the optical axis, from the correlation with the neighbours on them.

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
    mean, spread = _moments(picture.grey, radius)
    cost = np.full(allowed.shape, WORST, np.uint8)
    for i, inverse_depth in enumerate(inverse_depths):
        if not allowed[i].any():
            continue
        box, inner = _box(allowed[i], radius)  # planes meet the hull in a part of the picture
        K = picture.K.copy()
        K[:2, 2] -= box[1].start, box[0].start
        part = Picture(picture.grey[box], K, picture.T_world_camera)
        best = _best_half([_correlation(part.grey, mean[box], spread[box],
                                        _warped(part, neighbour, inverse_depth), radius)[inner]
                           for neighbour in neighbours])
        here = tuple(slice(b.start + a.start, b.start + a.stop) for a, b in zip(inner, box))
        cost[i][here] = np.where(allowed[i][here], np.clip(1 - best, 0, 1) * WORST, WORST)
    return cost


def _box(mask: np.ndarray, margin: int) -> tuple[tuple[slice, slice], tuple[slice, slice]]:
    """The rows and columns that hold all of the mask, with a margin inside the image; and
    within these those without the margin."""
    outer, inner = [], []
    for axis in (1, 0):
        where = np.nonzero(mask.any(axis=axis))[0]
        first, last = int(where[0]), int(where[-1]) + 1
        start = max(first - margin, 0)
        outer.append(slice(start, last + margin))
        inner.append(slice(first - start, last - start))
    return (outer[0], outer[1]), (inner[0], inner[1])


def _best_half(scores: list[np.ndarray]) -> np.ndarray:
    """Mean of the higher half of some images, pixel by pixel."""
    top: list[np.ndarray] = []  # best first
    for score in scores:
        for rank in range(len(top)):
            top[rank], score = np.maximum(top[rank], score), np.minimum(top[rank], score)
        if len(top) < (len(scores) + 1) // 2:
            top.append(score)
    return np.mean(top, axis=0)


def _moments(grey: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray]:
    """(h, w) float32 mean and variance in the windows around all pixels."""
    side = (2 * radius + 1,) * 2
    mean = cv2.blur(grey, side)
    return mean, np.maximum(cv2.blur(grey * grey, side) - mean * mean, 0) + _GREY_NOISE**2


def _correlation(grey: np.ndarray, mean: np.ndarray, spread: np.ndarray, other: np.ndarray,
                 radius: int) -> np.ndarray:
    """(h, w) float32 normalised cross-correlation, -1 to 1, of a picture of known moments with
    another."""
    other_mean, other_spread = _moments(other, radius)
    together = cv2.blur(grey * other, (2 * radius + 1,) * 2) - mean * other_mean
    return together / np.sqrt(spread * other_spread)


def _warped(picture: Picture, neighbour: Picture, inverse_depth: float) -> np.ndarray:
    """(h, w) float32 grey levels of the neighbour as the reference sees them on the plane."""
    T = geometry.inverse(neighbour.T_world_camera) @ picture.T_world_camera
    through = T[:3, :3] + np.outer(T[:3, 3], [0, 0, inverse_depth])
    homography = neighbour.K @ through @ np.linalg.inv(picture.K)
    return cv2.warpPerspective(neighbour.grey, homography, picture.grey.shape[::-1],
                               flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
                               borderMode=cv2.BORDER_REPLICATE)


def aggregate(cost: np.ndarray, grey: np.ndarray, small: int, large: int) -> np.ndarray:
    """Sum of the costs of the cheapest paths to every pixel and plane from eight sides.

    Args:
        cost: (d, h, w) uint8.
        grey: (h, w) float32 grey levels; a jump of depth costs less where they jump.
        small: cost of a step by one plane.
        large: cost of a larger jump in an even region.

    Returns:
        (d, h, w) uint16.
    """
    total = np.zeros(cost.shape, np.uint16)
    for turned in (False, True):  # along columns, then along rows
        axes = (2, 0, 1) if turned else (1, 0, 2)  # (d, h, w) -> (steps, d, across)
        lines = np.ascontiguousarray(cost.transpose(axes)).astype(np.uint16)
        picture = grey.T if turned else grey
        out = np.zeros_like(lines)
        for shift in _SHIFTS[:1] if turned else _SHIFTS:
            for way in (1, -1):
                _add_paths(lines[::way], picture[::way], shift, out[::way], small, large)
        total += out.transpose(np.argsort(axes))
    return total


def _add_paths(lines: np.ndarray, grey: np.ndarray, shift: int, out: np.ndarray, small: int,
               large: int) -> None:
    """Adds the path costs, from the first line on, to `out`.

    Args:
        lines: (n, d, m) uint16 cost of n lines of m pixels.
        grey: (n, m) grey levels.
        shift: by how many pixels a path moves along the line from one line to the next.
    """
    n, planes, width = lines.shape
    here, there = slice(max(shift, 0), width + min(shift, 0)), slice(
        max(-shift, 0), width - max(shift, 0))
    before = lines[0].copy()
    out[0] += before
    padded = np.full((planes + 2, width), _FORBIDDEN, np.uint16)
    for i in range(1, n):
        step = np.abs(grey[i, here] - grey[i - 1, there])
        jump = np.maximum(large / (1 + step / 8), small).astype(np.uint16)
        old = before[:, there]
        lowest = old.min(axis=0)
        ends = padded[:, here]
        np.add(old, np.uint16(small), out=ends[1:-1])
        way = np.minimum(ends[:-2], ends[2:])
        np.minimum(way, old, out=way)
        np.minimum(way, lowest + jump, out=way)
        way -= lowest
        now = lines[i].copy()
        now[:, here] += way
        out[i] += now
        before = now


def best_planes(total: np.ndarray, allowed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The cheapest plane of every pixel, between planes by a parabola, and how clear it is.

    Args:
        total: (d, h, w) uint16 cost.
        allowed: (d, h, w) bool, the planes that a pixel may take.

    Returns:
        (h, w) float32 position among the planes, and (h, w) float32 share by which the second
        best, not next to the best, costs more; position -1 and share 0 where none is allowed.
    """
    cost = np.where(allowed, total, _FORBIDDEN)
    index = np.argmin(cost, axis=0)
    planes = len(total)

    def at(shift: int) -> np.ndarray:
        place = np.clip(index + shift, 0, planes - 1)
        return np.take_along_axis(total, place[None], axis=0)[0].astype(np.float32)

    low, middle, high = at(-1), at(0), at(1)
    bend = low - 2 * middle + high
    inside = (index > 0) & (index < planes - 1) & (bend > 0)
    offset = np.where(inside, (low - high) / np.maximum(2 * bend, 1), 0)
    for shift in range(-2, 3):
        np.put_along_axis(cost, np.clip(index + shift, 0, planes - 1)[None], _FORBIDDEN, axis=0)
    second = cost.min(axis=0).astype(np.float32)
    known = allowed.any(axis=0)
    margin = np.where(known, second / np.maximum(middle, 1) - 1, 0)
    position = np.where(known, index + np.clip(offset, -0.5, 0.5), -1)
    return position.astype(np.float32), margin.astype(np.float32)
