# SPDX-License-Identifier: Apache-2.0
"""The published rule for the volume of a stack, stated anew to be measured beside ours.

A grid of 100 x 100 x 100 voxels fills the upright bounding box of container and parts. A view
votes against every voxel whose centre it sees outside the mask, or in front of the depth image;
a voxel that projects beside the image gets no vote and stays. What is left is container and
parts; the container's walls are then peeled off along the grid's axes. The paper and the code
that its authors released differ, so both are here:

* `WRITTEN`: one vote removes a voxel; all sides except the top lose the wall's thickness. Only
  the outer ends of the grid's lines are taken for sides: eroding every surface would eat bumps.
* `RELEASED`: five votes do. Every change between empty and full along x or y, and every bottom
  face, is widened by half of the thickness to either side and removed. Neighbours are looked up
  around the end of the grid.

V here is another one than ours. It is what no view proves empty, less a skin: space that only
oblique views see below overhangs is removed, what hangs over the rim is included, the floor is as
thick as the wall, and walls are those of a box along the world's axes. Ours is the integral over
the rim opening between inner and highest surface. Both are compared with the truth of ours: part
of the rule's difference is that of definitions, and a gamma fitted to its V would absorb it.

The rule gets what its authors estimate: true masks, bounding box and wall thickness. Depth images
and poses are the ones that we get; theirs are rendered from Gaussian splats.

Source: paper, section 3.3, "Volume Estimation", and the code published with it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.types import BACKGROUND, View

# Voxels along each side of the grid. Source: paper, section 3.3.
CELLS = 100
# Empty voxels beside and above the true box, chosen: a fitted box is not tight either.
_MARGIN = 2


@dataclass(frozen=True)
class Rule:
    """One reading of the rule.

    Attributes:
        votes: number of votes that remove a voxel.
        as_written: walls are peeled as the paper writes, else as the released code does.
    """

    votes: int
    as_written: bool


WRITTEN, RELEASED = Rule(votes=1, as_written=True), Rule(votes=5, as_written=False)


@dataclass(frozen=True, eq=False)
class Grid:
    """Voxels of an upright box, world frame, metres.

    Attributes:
        low: (3,) lowest corner.
        sides: (3,) sides of a voxel.
        cells: number of voxels along each side.
    """

    low: np.ndarray
    sides: np.ndarray
    cells: int = CELLS

    @classmethod
    def around(cls, points: np.ndarray, cells: int = CELLS) -> Grid:
        """The grid around what (n, 3) points span, metres, world."""
        low, high = points.min(axis=0), points.max(axis=0)
        sides = (high - low) / (cells - np.array([2, 2, 1]) * _MARGIN)
        return cls(low - sides * [_MARGIN, _MARGIN, 0], sides, cells)

    def centers(self) -> np.ndarray:
        """(cells**3, 3) float64 centres, x slowest."""
        index = np.indices((self.cells,) * 3).reshape(3, -1).T
        return self.low + (index + 0.5) * self.sides


def volume_by_rule(views: list[View], grid: Grid, wall_m: float, rule: Rule) -> float:
    """V by the rule, m3.

    Args:
        views: pinhole views with labels and depth.
        grid: around container and parts.
        wall_m: thickness of the container's wall; 0 for none.
        rule: which reading of the rule.
    """
    # Carve by votes
    points = grid.centers()
    votes = np.zeros(len(points), np.int32)
    for view in views:
        votes += removal_votes(view, points)
    full = (votes < rule.votes).reshape((grid.cells,) * 3)
    # Peel the container's walls off
    if wall_m > 0:
        full = _peel_as_written(full, np.round(wall_m / grid.sides).astype(int)) \
            if rule.as_written else _peel_as_released(full, round(wall_m / grid.sides[0]))
    return float(np.count_nonzero(full) * np.prod(grid.sides))


def removal_votes(view: View, points: np.ndarray) -> np.ndarray:
    """(n,) bool: the voxels at (n, 3) points, world, metres, that the view votes to remove."""
    assert view.depth is not None and view.labels is not None  # for the type checker
    pixels = geometry.project_into(view, points)
    rows, cols = pixels.rows, pixels.cols
    votes = np.zeros(len(points), bool)
    votes[pixels.inside] = (view.labels[rows, cols] == BACKGROUND) \
        | (pixels.depth < view.depth[rows, cols])
    return votes


def removal_votes_by_loop(view: View, points: np.ndarray) -> np.ndarray:
    """Counts the votes of `removal_votes` one voxel at a time, as the released code runs."""
    assert view.depth is not None and view.labels is not None  # for the type checker
    k = view.intrinsics
    local = geometry.apply(geometry.inverse(view.T_world_camera), points)
    pixels, depths = geometry.project(local, k)
    pixels = np.round(pixels).astype(int)
    votes = np.zeros(len(points), bool)
    for i, ((x, y), z) in enumerate(zip(pixels, depths)):
        if z <= 0 or not (0 <= x < k.width and 0 <= y < k.height):
            continue
        if view.labels[y, x] == BACKGROUND or z < view.depth[y, x]:
            votes[i] = True
    return votes


def _peel_as_written(full: np.ndarray, steps: np.ndarray) -> np.ndarray:
    """Removes the outermost `steps` (3,) voxels of every line along x and y, the lowest along z.

    Returns (n, n, n) bool.
    """
    peeled, cells = full.copy(), len(full)
    for axis in range(3):
        along = np.arange(cells).reshape(np.roll([cells, 1, 1], axis))
        first = np.argmax(full, axis, keepdims=True)
        last = cells - 1 - np.argmax(np.flip(full, axis), axis, keepdims=True)
        peeled &= along >= first + steps[axis]
        if axis < 2:
            peeled &= along <= last - steps[axis]
    return peeled


def _peel_as_released(full: np.ndarray, width: int) -> np.ndarray:
    """Removes a skin of `width` voxels around every change along x or y, and around bottom faces.

    Returns (n, n, n) bool.
    """
    if width < 1:
        return full
    sides = (full != np.roll(full, -1, 0)) | (full != np.roll(full, -1, 1))
    bottom = full & ~np.roll(full, 1, 2)
    return full & ~ndimage.maximum_filter(sides | bottom, width, mode="constant")
