# SPDX-License-Identifier: Apache-2.0
"""Which views of a scan contradict the others: what they show is free space to those."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.fusion.registration import pair_views
from stack_counter.types import View


@dataclass(frozen=True)
class AgreementSettings:
    """When views contradict each other.

    Attributes:
        stride: least pixels between the points of two views that are compared; chosen.
        max_points: largest number of points of a view, about; chosen.
        next_views: number of following views, in a ring, that each is compared with; chosen.
        min_shared_points: least number of points that two views must share; chosen.
        see_through_m: distance behind another view's point that one must see to contradict it,
            m; chosen.
        see_through_noise: the same in standard deviations of a depth point; chosen.
        max_contradicted: largest share of its points that the others may contradict of a view,
            in the median over those others; chosen.
    """

    stride: int = 8
    max_points: int = 5000
    next_views: int = 2
    min_shared_points: int = 50
    see_through_m: float = 0.02
    see_through_noise: float = 5
    max_contradicted: float = 0.25


SETTINGS = AgreementSettings()


@dataclass(frozen=True, eq=False)
class ViewPair:
    """What two views say of each other.

    Attributes:
        first, second: indices of the views.
        contradicted: share of the points of one that are free space to the other: the larger of
            both.
        apart_m: median distance between what both show, m, but for what one hides from the other.
    """

    first: int
    second: int
    contradicted: float
    apart_m: float


def compare_views(views: list[View], depth_noise_m: float) -> list[ViewPair]:
    """Compares each view with the next ones.

    Args:
        views: with depth.
        depth_noise_m: standard deviation of a depth point, m.

    Returns:
        The pairs of views that share enough points.
    """
    clouds = [_world_cloud(view) for view in views]
    limit = max(SETTINGS.see_through_m, SETTINGS.see_through_noise * depth_noise_m)
    pairs = []
    for first, second in pair_views(len(views), SETTINGS.next_views):
        behind = [_distances_behind(clouds[a], views[b])
                  for a, b in ((first, second), (second, first))]
        behind = [distances for distances in behind
                  if len(distances) >= SETTINGS.min_shared_points]
        if behind:
            visible = np.concatenate(behind)
            visible = visible[visible > -limit]
            pairs.append(ViewPair(
                first, second, max(float(np.mean(distances > limit)) for distances in behind),
                float(np.median(np.abs(visible))) if len(visible) else limit))
    return pairs


def contradicting_views(pairs: list[ViewPair], count: int) -> list[int]:
    """Finds the views that most of those beside them contradict, the worst first.

    Each is left out before the next is looked for: what contradicts only it is not to blame.

    Args:
        pairs: of the scan.
        count: number of its views.

    Returns:
        Their indices; both where only two are left, as nothing says which of them is wrong.
    """
    off: list[int] = []
    while True:
        shares: dict[int, list[float]] = {}
        for pair in pairs:
            if pair.first not in off and pair.second not in off:
                shares.setdefault(pair.first, []).append(pair.contradicted)
                shares.setdefault(pair.second, []).append(pair.contradicted)
        medians = {view: float(np.median(of_view)) for view, of_view in shares.items()}
        wrong = [view for view, share in medians.items() if share > SETTINGS.max_contradicted]
        if not wrong:
            return off
        if len(off) == count - 2:
            return off + wrong
        off.append(max(wrong, key=lambda view: (medians[view], sum(shares[view]))))


def clearly_contradicting_views(pairs: list[ViewPair], count: int, min_views: int) -> list[int]:
    """Finds the views that contradict a clear majority of others; none where that is not clear.

    Args:
        pairs: of the scan.
        count: number of its views.
        min_views: fewest views of a scan.

    Returns:
        Their indices.
    """
    off = contradicting_views(pairs, count)
    return off if _is_majority(count - len(off), off, min_views) else []


def _is_majority(kept: int, off: list[int], min_views: int) -> bool:
    """Whether so many views kept are enough, and more than those that are off."""
    return kept >= max(min_views, 2) and kept > len(off)


def check_agreement(views: list[View], pairs: list[ViewPair], min_views: int) -> list[int]:
    """Finds the views to leave out, or refuses a scan of which too few agree.

    Args:
        views: of the scan.
        pairs: as compared.
        min_views: fewest views of a scan.

    Returns:
        Indices of views that contradict the others; most of the scan agrees.

    Raises:
        ScanError: it is not clear which views are right, or too few of them are.
    """
    off = contradicting_views(pairs, len(views))
    if off and not _is_majority(len(views) - len(off), off, min_views):
        of_off = [pair for pair in pairs if pair.first in off or pair.second in off]
        apart = max(pair.apart_m for pair in of_off)
        share = max(pair.contradicted for pair in of_off)
        names = ", ".join(name_view(views[i], i) for i in sorted(off))
        raise ScanError(
            f"the views disagree by {1000 * apart:.0f} mm, {share:.0%} of what one sees is free "
            f"space to the next (off: {names}); expected below {SETTINGS.max_contradicted:.0%}: "
            "poses of another frame or another time than the images, or depth in another unit "
            "(depth_scale)")
    return off


def name_view(view: View, index: int) -> str:
    """Names a view for people: its number from 1, its camera frame and its stamp, s."""
    camera = f" of {view.camera}" if view.camera else ""
    return f"view {index + 1}{camera} at {view.stamp_ns / 1e9:.3f} s"


def _world_cloud(view: View) -> np.ndarray:
    """(n, 3) float64 world points of every few pixels of a view, m."""
    stride = geometry.stride_for(view, SETTINGS.stride, SETTINGS.max_points)
    points = geometry.world_points(view, stride).reshape(-1, 3)
    return points[np.isfinite(points[:, 2])].astype(float)


def _distances_behind(points: np.ndarray, other: View) -> np.ndarray:
    """(k,) metres that another view sees behind (n, 3) world points, where it has depth."""
    assert other.depth is not None  # for the type checker
    pixels = geometry.project_into(other, points)
    measured = other.depth[pixels.rows, pixels.cols]
    return (measured - pixels.depth)[measured > 0]
