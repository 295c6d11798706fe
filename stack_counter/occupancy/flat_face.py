# SPDX-License-Identifier: Apache-2.0
"""The largest flat face in a stack's surface: a lid, a sheet or a box on it is no pile of parts.

Planes through the neighbourhoods of random cells are held against the surface; the face is the
largest connected piece that lies in one of them.

Source: Fischler and Bolles, "Random sample consensus" (1981).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps


@dataclass(frozen=True)
class FlatFaceSettings:
    """What counts as one flat face, how many are tried, and from when on one is no part's.

    Attributes:
        max_share: largest share of the opening that a flat face of parts takes, where the
            container is not so narrow that `large_part` is said: at most 0.12 in 950 piles of
            training seen as fused, among them plates, tiles and displays.
        min_height: over the inner surface, part lengths, from which a face lies on parts and is
            not the container's floor; chosen.
        tolerance: distance from its plane up to which a cell belongs to a face, part lengths;
            chosen.
        steepest: slope of the steepest face that is looked for; chosen.
        window: side of a neighbourhood, cells; chosen: a part length.
        planes: number of planes that are tried; chosen: a face of a fifth of the opening is
            missed by all of them once in 10,000 times.
        most_cells: along a side of the map that is looked at; larger ones are thinned.
    """

    max_share: float = 0.2
    min_height: float = 0.5
    tolerance: float = 0.08
    steepest: float = 1.5
    window: int = 9
    planes: int = 40
    most_cells: int = 240


SETTINGS = FlatFaceSettings()


def has_foreign_face(maps: StackMaps) -> bool:
    """Whether a flat face takes more of a stack's surface than one of a part can."""
    return largest_flat_share(maps) > SETTINGS.max_share


def largest_flat_share(maps: StackMaps) -> float:
    """Share of a stack's surface that its largest flat face takes, above the floor."""
    s = SETTINGS
    step = -(-max(maps.valid.shape) // s.most_cells)
    top = maps.top[::step, ::step].astype(np.float64)
    stack = (maps.valid & (maps.height > s.min_height))[::step, ::step]
    total = np.count_nonzero(maps.valid[::step, ::step])
    fitted = _fit_planes(top, stack)
    slope = np.hypot(fitted[1], fitted[2]) * PIXELS_PER_LENGTH / step
    seeds = np.argwhere(slope <= s.steepest)
    if len(seeds) == 0:
        return 0.0
    random = np.random.default_rng(0)
    rows, cols = np.indices(top.shape)
    largest = 0
    for row, col in random.permutation(seeds)[:s.planes]:
        level, along_rows, along_cols = fitted[:, row, col]
        plane = level + along_rows * (rows - row) + along_cols * (cols - col)
        on_it = stack & (np.abs(top - plane) < s.tolerance)
        if on_it[row, col] and np.count_nonzero(on_it) > largest:
            _, pieces = cv2.connectedComponents(on_it.astype(np.uint8), connectivity=4)
            largest = max(largest, int(np.count_nonzero(pieces == pieces[row, col])))
    return largest / total


def _fit_planes(top: np.ndarray, stack: np.ndarray) -> np.ndarray:
    """Fits a plane to the neighbourhood of each cell, by least squares.

    Args:
        top: (rows, cols) heights, part lengths.
        stack: (rows, cols) bool: the surface of parts, or of what lies on them.

    Returns:
        (3, rows, cols) height in the cell, and slopes along rows and columns, part lengths a
        cell; NaN where less than four fifths of the neighbourhood is the stack's.
    """
    side = (SETTINGS.window, SETTINGS.window)
    weights = cv2.boxFilter(stack.astype(np.float64), -1, side, normalize=False)
    index: np.ndarray = np.indices(top.shape, dtype=np.float64)
    rows, cols = index[0], index[1]

    def mean(values: np.ndarray) -> np.ndarray:
        sums = cv2.boxFilter(np.where(stack, values, 0), -1, side, normalize=False)
        return np.asarray(sums / np.maximum(weights, 1))

    row, col, height = mean(rows), mean(cols), mean(top)
    row_row, col_col = mean(rows * rows) - row * row, mean(cols * cols) - col * col
    row_col = mean(rows * cols) - row * col
    row_height, col_height = mean(rows * top) - row * height, mean(cols * top) - col * height
    whole = stack & (weights >= 0.8 * side[0] * side[1])
    determinant = np.where(whole, row_row * col_col - row_col**2, np.nan)
    along_rows = (row_height * col_col - col_height * row_col) / determinant
    along_cols = (col_height * row_row - row_height * row_col) / determinant
    level = height + along_rows * (rows - row) + along_cols * (cols - col)
    return np.stack([level, along_rows, along_cols])
