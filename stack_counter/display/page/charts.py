# SPDX-License-Identifier: Apache-2.0
"""Figures of a report as numbers that its template draws: histogram, fill grid, shares."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.types import StackCount, StackVolume


@dataclass(frozen=True)
class ChartSettings:
    """How figures are divided; all chosen.

    Attributes:
        max_bars: of the histogram; twice the cube root of the number of values if that is less
            (Rice's rule).
        tail: share of the counts beyond each end of the histogram.
        grid_cells: of a heap's grid along its longer side; that of a container is a setting.
        min_cell_share: share of a cell of the grid that lies over the opening, or else it is
            empty.
        ticks: about so many of an axis.
        dark_below: luminance of a ground below which white text stands out more than black.
    """

    max_bars: int = 28
    tail: float = 0.005
    grid_cells: int = 8
    min_cell_share: float = 0.25
    ticks: int = 5
    dark_below: float = 0.18


SETTINGS = ChartSettings()


@dataclass(frozen=True)
class Bar:
    """One bar of the histogram.

    Attributes:
        low, high: the counts that it holds, from and to, inclusive.
        share: of all counts, 0 to 1.
    """

    low: int
    high: int
    share: float


@dataclass(frozen=True)
class Histogram:
    """The distribution of the count.

    Attributes:
        bars: side by side, of one width.
        ticks: whole numbers for the axis.
    """

    bars: tuple[Bar, ...]
    ticks: tuple[int, ...]

    @property
    def span(self) -> tuple[float, float]:
        """Ends of the axis, parts."""
        return self.bars[0].low - 0.5, self.bars[-1].high + 0.5

    @property
    def highest(self) -> float:
        """Largest share of a bar."""
        return max(bar.share for bar in self.bars)


def count_histogram(count: StackCount) -> Histogram | None:
    """Returns the histogram of a count's distribution; None where that is unknown or one value."""
    if count.distribution is None or not len(count.distribution):
        return None
    numbers = np.round(count.distribution)
    low, high = np.quantile(numbers, [SETTINGS.tail, 1 - SETTINGS.tail], method="nearest")
    low, high = min(low, count.count_interval[0]), max(high, count.count_interval[1])
    if low == high:
        return None
    most = min(SETTINGS.max_bars, math.ceil(2 * len(numbers) ** (1 / 3)))
    width = math.ceil((high - low + 1) / most)
    edges = np.arange(low, high + width + 0.5, width) - 0.5
    shares = np.histogram(numbers, edges)[0] / len(numbers)
    bars = tuple(Bar(int(edge + 0.5), int(edge + 0.5) + width - 1, float(share))
                 for edge, share in zip(edges[:-1], shares))
    return Histogram(bars, tuple(int(tick) for tick in _ticks(bars[0].low, bars[-1].high)))


def _ticks(low: float, high: float) -> np.ndarray:
    """Returns round numbers from low to high, about as many as the settings say."""
    rough = max(high - low, 1e-9) / SETTINGS.ticks
    power = 10.0 ** math.floor(math.log10(rough))
    step = min((m * power for m in (1, 2, 5, 10)), key=lambda s: abs(math.log(s / rough)))
    step = max(step, 1.0)
    return np.arange(math.ceil(low / step), math.floor(high / step) + 1) * step


@dataclass(frozen=True)
class GridCell:
    """One cell of the fill grid.

    Attributes:
        text: level, percent of the inner height, or height, mm; empty beside the opening.
        color, ink: of its ground and its text, as CSS writes them.
    """

    text: str
    color: str = "none"
    ink: str = "none"


@dataclass(frozen=True)
class FillGrid:
    """The mean fill over each cell of a grid.

    Attributes:
        rows: of cells, y of the map upwards.
        unit: of their texts.
    """

    rows: tuple[tuple[GridCell, ...], ...]
    unit: str


def fill_grid(volume: StackVolume) -> FillGrid | None:
    """Returns the filling level, or heights over the support plane; None if neither is known."""
    if volume.filling_level is not None:
        cols, rows = volume.filling_level.cell_count
        means = [cell.level_in_percent.mean for cell in volume.filling_level.cells]
        return _grid_of(np.reshape(means, (rows, cols)), 100.0, "%")
    if volume.top is None or volume.inner is None:
        return None
    heights = np.maximum(volume.top.heights - volume.inner.heights, 0)
    if not np.isfinite(heights).any():
        return None
    levels = 1000 * cell_means(heights)
    return _grid_of(levels, max(float(np.nanmax(levels)), 1e-9), "mm")


def _grid_of(levels: np.ndarray, full: float, unit: str) -> FillGrid:
    """Returns the grid of (rows, cols) levels; `full`: the level that is drawn as full."""
    rows = tuple(tuple(_grid_cell(level, level / full) for level in row) for row in levels[::-1])
    return FillGrid(rows, unit)


def cell_means(values: np.ndarray) -> np.ndarray:
    """Returns the means of (rows, cols) values over cells as square as can be; NaN beside them."""
    marked = np.argwhere(np.isfinite(values))
    first, last = marked.min(axis=0), marked.max(axis=0) + 1
    values = values[first[0]:last[0], first[1]:last[1]]
    cells = np.maximum(np.round(SETTINGS.grid_cells * np.array(values.shape)
                                / max(values.shape)), 1).astype(int)
    means = np.full(cells, np.nan)
    for index in np.ndindex(*cells):
        rows, cols = (slice(i * size // n, max((i + 1) * size // n, i * size // n + 1))
                      for i, size, n in zip(index, values.shape, cells))
        block = values[rows, cols]
        if np.isfinite(block).mean() >= SETTINGS.min_cell_share:
            means[index] = np.nanmean(block)
    return means


def _grid_cell(level: float, share: float) -> GridCell:
    if not math.isfinite(level):
        return GridCell("")
    color = cv2.applyColorMap(np.array([[255 * min(max(share, 0), 1)]], np.uint8),
                              cv2.COLORMAP_VIRIDIS)[0, 0, ::-1]
    luminance = float((color / 255) ** 2.2 @ [0.2126, 0.7152, 0.0722])
    return GridCell(f"{level:.0f}", "#{:02x}{:02x}{:02x}".format(*color),
                    "#000" if luminance > SETTINGS.dark_below else "#fff")


@dataclass(frozen=True)
class Share:
    """One share of a whole.

    Attributes:
        name: what it is.
        share: 0 to 1.
        start: share of those before it.
        text: its value.
    """

    name: str
    share: float
    start: float
    text: str


def stacked_shares(values: Mapping[str, float], texts: Mapping[str, str]) -> list[Share]:
    """Returns the shares of values that add up to a whole; those of zero are left out.

    Args:
        values: 0 or more, by name.
        texts: of the same names; what stands beside the share.
    """
    total, start, shares = sum(values.values()), 0.0, []
    for name, value in values.items():
        if value > 0:
            shares.append(Share(name, value / total, start, texts[name]))
            start += value / total
    return shares
