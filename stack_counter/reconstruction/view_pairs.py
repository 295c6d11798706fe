# SPDX-License-Identifier: Apache-2.0
"""What pairs of views say of each other: how much of what one shows is free space to the other."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.fusion.registration import pair_views
from stack_counter.types import View


@dataclass(frozen=True)
class ViewPairSettings:
    """How two views are compared.

    Attributes:
        stride: least pixels between the points of two views that are compared; chosen.
        max_points: largest number of points of a view, about; chosen.
        next_views: number of following views, in a ring, that each is compared with; chosen.
        min_shared_points: least number of points that two views must share; chosen.
        see_through_m: distance behind another view's point that one must see to contradict it,
            m; chosen.
        see_through_noise: the same in standard deviations of a depth point; chosen.
        edge_px: distance, pixels, up to which a nearer depth in the other view says that a point
            is there: beside the edge of a wall it sees past it; chosen.
        standing_m: height above the support from which on points in the region stand, m: what has
            moved leaves the plane around it as it was; chosen.
    """

    stride: int = 8
    max_points: int = 5000
    next_views: int = 2
    min_shared_points: int = 50
    see_through_m: float = 0.02
    see_through_noise: float = 5
    edge_px: int = 3
    standing_m: float = 0.012


SETTINGS = ViewPairSettings()


@dataclass(frozen=True, eq=False)
class ViewPair:
    """What two views say of each other.

    Attributes:
        first, second: indices of the earlier and the later view.
        contradicted: share of the points of one, or of those that stand, that are free space to
            the other: the largest.
        contradicted_in_all: the same of all points alone.
        appeared: that share of the later one's: the earlier one saw through it, it was not there
            then. What is taken away during a scan is no such thing, and is carved away.
        apart_m: median distance between what both show, m, but for what one hides from the other.
    """

    first: int
    second: int
    contradicted: float
    contradicted_in_all: float
    appeared: float
    apart_m: float


def compare_views(views: list[View], region: Region) -> list[ViewPair]:
    """Compares each view with the next ones.

    Args:
        views: with depth.
        region: says where the support is, and how noisy depth points are.

    Returns:
        The pairs of views that share enough points.
    """
    clouds = [_world_cloud(view) for view in views]
    nearest = lru_cache(maxsize=8)(lambda i: _nearest_beside(views[i]))  # of neighbours alone
    limit = max(SETTINGS.see_through_m, SETTINGS.see_through_noise * region.noise)
    pairs = []
    for first, second in pair_views(len(views), SETTINGS.next_views):
        behind = [_points_behind(clouds[a], views[b], nearest(b), region)
                  for a, b in ((first, second), (second, first))]
        known = [points.distances for points in behind
                 if len(points.distances) >= SETTINGS.min_shared_points]
        if known:
            visible = np.concatenate(known)
            visible = visible[visible > -limit]
            of_all, of_standing = ([points.contradicted_share(limit, standing)
                                    for points in behind] for standing in (False, True))
            pairs.append(ViewPair(
                first, second, max(*of_all, *of_standing), max(of_all),
                max(of_all[1], of_standing[1]),
                float(np.median(np.abs(visible))) if len(visible) else limit))
    return pairs


def _world_cloud(view: View) -> np.ndarray:
    """(n, 3) float64 world points of every few pixels of a view, m."""
    stride = geometry.stride_for(view, SETTINGS.stride, SETTINGS.max_points)
    points = geometry.world_points(view, stride).reshape(-1, 3)
    return points[np.isfinite(points[:, 2])].astype(float)


@dataclass(frozen=True, eq=False)
class _PointsBehind:
    """How far another view with depth sees behind k of a view's points.

    Attributes:
        distances: (k,) metres.
        past_edges: (k,) the least of these distances within some pixels of each, metres.
        standing: (k,) bool, whether a point stands on the support in the region.
    """

    distances: np.ndarray
    past_edges: np.ndarray
    standing: np.ndarray

    def contradicted_share(self, limit: float, of_standing: bool) -> float:
        """Share behind which the other sees by more than `limit`, m, of all or of what stands."""
        free = self.past_edges[self.standing if of_standing else slice(None)] > limit
        return float(np.mean(free)) if len(free) >= SETTINGS.min_shared_points else 0.0


def _nearest_beside(view: View) -> np.ndarray:
    """(h, w) float32 least depth of a view within a few pixels of each, m; inf where none is."""
    depth = np.asarray(view.depth, np.float32)
    return cv2.erode(np.where(depth > 0, depth, np.float32(np.inf)),
                     np.ones((2 * SETTINGS.edge_px + 1,) * 2))


def _points_behind(points: np.ndarray, other: View, nearest: np.ndarray, region: Region
                   ) -> _PointsBehind:
    """Holds (n, 3) world points against the depth of another view, and its `_nearest_beside`."""
    assert other.depth is not None  # for the type checker
    pixels = geometry.project_into(other, points)
    measured = other.depth[pixels.rows, pixels.cols]
    known = measured > 0
    held = points[pixels.inside][known]
    above = held[:, 2] - region.plane_z
    return _PointsBehind((measured - pixels.depth)[known],
                         (nearest[pixels.rows, pixels.cols] - pixels.depth)[known],
                         region.contains(held)
                         & (above > max(SETTINGS.standing_m, region.noise_height)))
