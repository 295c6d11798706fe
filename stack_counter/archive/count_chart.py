# SPDX-License-Identifier: Apache-2.0
"""Counts of one part over time, as numbers of a drawing."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

_FIRST_DATE = "2000"  # stamps before are of a clock that began with the scan


@dataclass(frozen=True)
class ChartSettings:
    """Size of a drawing, in its own units; chosen.

    Attributes:
        width, height: of the area with the counts.
        ticks: about how many numbers stand at the side.
    """

    width: int = 1000
    height: int = 180
    ticks: int = 4


SETTINGS = ChartSettings()


@dataclass(frozen=True)
class CountChart:
    """Drawing of the counts of one part.

    Attributes:
        part: its name.
        intervals, counts, changed: paths of SVG: a line for each interval, a dot for each count,
            and one for each count that changed.
        number: of the counts.
        low, high: least and largest count.
        y_ticks: (place, count) at the side.
        x_ticks: (place, text) below.
        by_time: whether from left to right is time; else it is the order of the bags' names.
    """

    part: str
    intervals: str
    counts: str
    changed: str
    number: int
    low: int
    high: int
    y_ticks: list[tuple[float, int]]
    x_ticks: list[tuple[float, str]]
    by_time: bool


def draw_counts(part: str, lines: Sequence[dict[str, Any]], changed: Sequence[bool]) -> CountChart:
    """Draws counts.

    Args:
        part: name of the part.
        lines: results with a count, at least one.
        changed: whether each is another than before.
    """
    stamps = [line["stamp"] for line in lines]
    by_time = min(stamps) >= _FIRST_DATE and len(set(stamps)) > 1
    places = [_seconds(stamp) for stamp in stamps] if by_time else [*range(len(lines))]
    first, last = min(places), max(places)
    xs = [SETTINGS.width * ((place - first) / (last - first) if last > first else 0.5)
          for place in places]
    step = _round_step(max(line["count_interval"][1] for line in lines) / SETTINGS.ticks)
    top = step * max(math.ceil(max(line["count_interval"][1] for line in lines) / step), 1)

    def y(count: int) -> float:
        return round(SETTINGS.height * (1 - count / top), 1)

    counts = [line["count"] for line in lines]
    bars = [f"M{x:.1f} {y(line['count_interval'][0])}V{y(line['count_interval'][1])}"
            for x, line in zip(xs, lines)]
    dots = [f"M{x:.1f} {y(count)}h0" for x, count in zip(xs, counts)]
    ends = [(0.0, min(stamps)[:10]), (float(SETTINGS.width), max(stamps)[:10])] if by_time else []
    return CountChart(
        part, "".join(bars), "".join(dot for dot, new in zip(dots, changed) if not new),
        "".join(dot for dot, new in zip(dots, changed) if new), len(lines), min(counts),
        max(counts), [(y(count), count) for count in range(0, top + 1, step)], ends, by_time)


def _seconds(stamp: str) -> float:
    return datetime.fromisoformat(stamp.replace("Z", "+00:00")).timestamp()


def _round_step(least: float) -> int:
    """Least of 1, 2, 5, 10, 20 and so on that is no smaller."""
    power = 10 ** max(math.floor(math.log10(max(least, 1))), 0)
    return next(power * factor for factor in (1, 2, 5, 10) if power * factor >= least)
