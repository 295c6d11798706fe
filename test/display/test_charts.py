# SPDX-License-Identifier: Apache-2.0
"""Figures of a report against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from kits.counted_bin import counted_bin

from stack_counter.display.page.charts import (
    cell_means,
    count_histogram,
    fill_grid,
    stacked_shares,
)
from stack_counter.types import Container


def test_the_histogram_holds_the_distribution():
    count = counted_bin()
    histogram = count_histogram(count)
    assert sum(bar.share for bar in histogram.bars) == pytest.approx(0.99, abs=0.01)
    mean = np.average([(bar.low + bar.high) / 2 for bar in histogram.bars],
                      weights=[bar.share for bar in histogram.bars])
    assert mean == pytest.approx(count.distribution.mean(), abs=0.5)
    low, high = count.count_interval
    assert histogram.span[0] < low and high < histogram.span[1]
    inside = sum(bar.share for bar in histogram.bars if low <= bar.low and bar.high <= high)
    assert inside == pytest.approx(count.confidence, abs=0.06)
    assert all(after.low == before.high + 1
               for before, after in zip(histogram.bars, histogram.bars[1:]))
    assert all(histogram.span[0] <= tick <= histogram.span[1] for tick in histogram.ticks)


def test_without_spread_there_is_no_histogram():
    count = counted_bin()
    assert count_histogram(replace(count, distribution=None)) is None
    assert count_histogram(replace(count, distribution=np.full(9, 3.0), count=3,
                                   count_interval=(3, 3))) is None
    few = count_histogram(replace(count, distribution=np.array([0.0, 1, 1, 2]), count=1,
                                  count_interval=(0, 2)))
    assert [bar.share for bar in few.bars] == [0.25, 0.5, 0.25]


def test_the_interval_follows_from_the_distribution():
    count = counted_bin()
    low, high = np.quantile(count.distribution, [0.05, 0.95])
    assert abs(count.count_interval[0] - low) < 1.5 and abs(count.count_interval[1] - high) < 1.5
    assert (np.diff(count.distribution) >= 0).all()


def test_the_grid_shows_the_fill_in_percent_of_the_depth():
    grid = fill_grid(counted_bin().volume)
    assert grid.unit == "%" and len(grid.rows) == 5 and len(grid.rows[0]) == 8
    levels = [int(cell.text) for cell in grid.rows[0]]
    assert levels == sorted(levels)
    assert levels[0] == pytest.approx(100 / 16, abs=1) and levels[-1] == pytest.approx(
        100 * 15 / 16, abs=1)
    assert grid.rows[0] == grid.rows[-1]


def test_the_grid_of_a_heap_shows_heights_in_mm_and_leaves_the_rest_free():
    volume = counted_bin().volume
    heights = np.full((40, 40), np.nan, np.float32)
    heights[:20], heights[20:, :20] = 0.02, 0.04
    top = replace(volume.top, heights=heights)
    grid = fill_grid(replace(volume, top=top, inner=replace(top, heights=0 * heights),
                             container=Container("none", np.eye(4)), filling_level=None))
    assert grid.unit == "mm" and {cell.text for row in grid.rows for cell in row} == {
        "20", "40", ""}
    assert grid.rows[0][0].text == "40" and grid.rows[0][-1].text == ""  # y upwards


def test_cells_of_a_small_map_are_its_own():
    assert cell_means(np.array([[1.0, 2.0], [3.0, np.nan]])).shape == (8, 8)


def test_shares_add_up_and_zeros_are_left_out():
    shares = stacked_shares({"a": 1.0, "b": 0.0, "c": 3.0}, {"a": "1", "b": "0", "c": "3"})
    assert [(s.name, s.start, s.share) for s in shares] == [("a", 0, 0.25), ("c", 0.25, 0.75)]
