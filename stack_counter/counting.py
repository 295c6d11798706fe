# SPDX-License-Identifier: Apache-2.0
"""count = gamma * V / v, and how sure that is (paper, equation 1)."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from stack_counter.errors import PartError
from stack_counter.types import OccupancyEstimate, Reason, SourceCount, StackCount, StackVolume

_ROUNDING = 1e-6  # of a part: an exact bound is not pushed to the next number by rounding
_MOST_PARTS = 1e9  # a count beyond it is of a part whose volume is wrong; chosen
_MOST_IN_MESSAGES = 2**32 - 1
_MOST_LOG = 700.0  # exp of more is no number


def check_unit_volume(unit_volume: float) -> float:
    """The volume of one part, m3.

    Raises:
        PartError: zero, negative or not finite.
    """
    if not (math.isfinite(unit_volume) and unit_volume > 0):
        raise PartError(f"unit volume is {unit_volume} m3; expected a finite number above 0")
    return unit_volume


def make_count(volume: StackVolume, unit_volume: float, estimate: OccupancyEstimate,
               confidence: float) -> StackCount:
    """The count with its interval.

    The interval is conformal: quantiles of the estimator's scores on families of parts it had not
    seen, times the relative standard deviation of this count, gamma and V together.

    Raises:
        PartError: unit volume not a positive number, or so small that no container holds the
            count.
    """
    expected = estimate.gamma * volume.stack_volume / check_unit_volume(unit_volume)
    if not expected <= _MOST_PARTS:
        raise PartError(f"{expected:.3g} parts of {unit_volume:.3g} m3 in "
                        f"{volume.stack_volume:.3g} m3; expected at most {_MOST_PARTS:.0e}: check "
                        "the part's volume")
    count = round(expected)
    low = high = float(count)
    distribution = None
    if volume.stack_volume > 0:
        spread = math.hypot(estimate.gamma_std / estimate.gamma,
                            volume.stack_volume_std / volume.stack_volume)
        distribution = _scaled(expected, np.sort(estimate.scores) * spread)
        low, high = (float(_scaled(expected, conformal_quantile(estimate.scores, share) * spread))
                     for share in ((1 - confidence) / 2, (1 + confidence) / 2))
    interval = whole_interval(low, count, high)
    result = StackCount(
        count=count, count_interval=interval,
        confidence=confidence, gamma=estimate.gamma, gamma_std=estimate.gamma_std,
        unit_volume=unit_volume, volume=volume, estimator=estimate.estimator,
        gamma_shares=estimate.shares, counted_scans=estimate.counted_scans,
        distribution=distribution, sources=(SourceCount("vision", count, interval, 1.0),))
    return with_reasons(result, *volume.reasons, *estimate.reasons)


def _scaled(count: float, log_factor: np.ndarray | float) -> np.ndarray:
    """A count times exp of something; no more than messages hold."""
    return np.minimum(count * np.exp(np.minimum(log_factor, _MOST_LOG)), _MOST_IN_MESSAGES)


def whole_interval(low: float, count: int, high: float) -> tuple[int, int]:
    """Widens an interval to whole numbers of parts, and to hold the count."""
    return (min(math.floor(low + _ROUNDING), count), max(math.ceil(high - _ROUNDING), count))


def with_reasons(count: StackCount, *reasons: Reason) -> StackCount:
    """Returns the count with further reasons, each named once, and the status they give it."""
    every = tuple(dict.fromkeys(count.reasons + reasons))
    degraded = any(reason.degrades for reason in every)
    return replace(count, reasons=every, status="degraded" if degraded else "ok")


def conformal_quantile(scores: np.ndarray, share: float) -> float:
    """The `share` quantile of a next score, of n that were seen.

    The k-th smallest with k of share * (n + 1), rounded away from the middle.

    Source: Vovk, Gammerman and Shafer, "Algorithmic Learning in a Random World" (2005).
    """
    n = len(scores)
    rank = share * (n + 1)
    k = math.floor(rank + _ROUNDING) if share < 0.5 else math.ceil(rank - _ROUNDING)
    return float(np.sort(scores)[min(max(k, 1), n) - 1])


def verdict(interval: tuple[int, int], expected: int, tolerance: int) -> str:
    """Judges an interval by what is expected.

    The verdict is `pass` if the whole interval lies within expected +- tolerance, `fail` if none
    of it does, `unsure` if it straddles a limit, and `none` if nothing is expected (0).
    """
    low, high = interval
    if expected == 0:
        return "none"
    if expected - tolerance <= low and high <= expected + tolerance:
        return "pass"
    if high < expected - tolerance or low > expected + tolerance:
        return "fail"
    return "unsure"
