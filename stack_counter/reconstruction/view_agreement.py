# SPDX-License-Identifier: Apache-2.0
"""Which views of a scan contradict the others: what they show is free space to those."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.errors import ScanError
from stack_counter.reconstruction.view_pairs import SETTINGS as PAIRS
from stack_counter.reconstruction.view_pairs import ViewPair
from stack_counter.types import View


@dataclass(frozen=True)
class AgreementSettings:
    """When views contradict each other.

    Attributes:
        max_contradicted: largest share of its points that the others may contradict of a view, in
            the median over those others. On `bags/demo` pairs of views have 1% at most, and 40% or
            more where a shift of 20 to 60 mm lies between them.
        max_contradicted_of_good: largest share of any pair of views whose poses are good. It is 2%
            at most where these are off by 0.5 mm and 0.05 degrees, and 11 to 34% where they are
            off by 3 mm and 0.3 degrees, on 26 training scans.
        max_split_pairs: largest number of pairs above `max_contradicted` among the views that are
            kept. What moves between two views lies between three or more pairs; chosen.
    """

    max_contradicted: float = 0.25
    max_contradicted_of_good: float = 0.1
    max_split_pairs: int = 1


SETTINGS = AgreementSettings()


def agree_throughout(pairs: list[ViewPair], count: int) -> bool:
    """Whether none of `count` views would be left out, and nothing lies between groups of them."""
    return not contradicting_views(pairs, count) and not split_pairs(pairs)


def count_contradicting(pairs: list[ViewPair]) -> int:
    """Number of pairs that contradict each other."""
    return sum(pair.contradicted > SETTINGS.max_contradicted for pair in pairs)


def split_pairs(pairs: list[ViewPair], off: Sequence[int] = ()) -> list[ViewPair]:
    """Finds what lies between groups of views that agree among themselves.

    Args:
        pairs: of the scan.
        off: indices of views that are left out.

    Returns:
        The pairs of other views of which the later shows what was not there in the earlier, the
        worst first; empty for one or so.
    """
    split = [pair for pair in pairs if pair.appeared > SETTINGS.max_contradicted
             and pair.first not in off and pair.second not in off]
    return sorted(split, key=lambda pair: -pair.appeared) \
        if len(split) > SETTINGS.max_split_pairs else []


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


def views_to_leave_out_first(pairs: list[ViewPair], count: int, min_views: int) -> list[int]:
    """Finds the views that are no good to register the others to.

    What stands says so where all others agree without these. Where poses are off by millimetres
    it does not: before they are mended, steep sides of parts and walls contradict each other in
    all views, and the support around them alone says which views are wrong.

    Args:
        pairs: of the scan, before it is registered.
        count: number of its views.
        min_views: fewest views of a scan.

    Returns:
        Their indices.
    """
    off = clearly_contradicting_views(pairs, count, min_views)
    if all(pair.contradicted <= SETTINGS.max_contradicted_of_good for pair in pairs
           if pair.first not in off and pair.second not in off):
        return off
    in_all = [replace(pair, contradicted=pair.contradicted_in_all) for pair in pairs]
    return clearly_contradicting_views(in_all, count, min_views)


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
        ScanError: it is not clear which views are right, or too few of them are, or the scene
            has changed between them.
    """
    off = contradicting_views(pairs, len(views))
    if off and not _is_majority(len(views) - len(off), off, min_views):
        of_off = [pair for pair in pairs if pair.first in off or pair.second in off]
        apart = max(PAIRS.see_through_m, *(pair.apart_m for pair in of_off))
        share = max(pair.contradicted for pair in of_off)
        names = ", ".join(name_view(views[i], i) for i in sorted(off))
        raise ScanError(
            f"the views disagree by {1000 * apart:.0f} mm or more, {share:.0%} of what one sees "
            f"is free space to the next (off: {names}); expected below "
            f"{SETTINGS.max_contradicted:.0%}: poses of another frame or another time than the "
            "images, depth in another unit (depth_scale), or a wrong calibration (camera_info, "
            "hand-eye)")
    if split := split_pairs(pairs, off):
        first, second = (name_view(views[i], i) for i in (split[0].first, split[0].second))
        raise ScanError(
            f"{len(split)} pairs of views disagree, {first} and {second} most: "
            f"{split[0].appeared:.0%} of what one shows is free space to the other; "
            f"expected below {SETTINGS.max_contradicted:.0%}: let nothing move or come into sight "
            "during a scan, and check the clocks of images and poses and the hand-eye calibration")
    return off


def name_view(view: View, index: int) -> str:
    """Names a view for people: its number from 1, its camera frame and its stamp, s."""
    camera = f" of {view.camera}" if view.camera else ""
    return f"view {index + 1}{camera} at {view.stamp_ns / 1e9:.3f} s"
