# SPDX-License-Identifier: Apache-2.0
"""How well a part's mesh explains the surface around one part, for thousands of guessed poses.

A mesh explains a cell of the part where the heights agree. It must not stand out above the surface
beside the part: what nobody sees there is not there. Where it lies below, something covers it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.types import HeightMap
from stack_counter.visible_parts.part_views import PartViews


@dataclass(frozen=True)
class FitSettings:
    """How a guess is judged; chosen.

    Attributes:
        tolerance: difference from which heights do not agree, part lengths.
        least_tolerance: the same, cells of the surface, however small the part is.
        beside: weight of a cell beside the part where the surface agrees with the mesh, as it
            should not; of one above which the mesh stands out, it is 1.
        averaged: differences that the mesh's height is averaged over, multiples of the tolerance,
            one after the other.
        block: cells that are judged at a time: they fit into a core's cache.
    """

    tolerance: float = 0.12
    least_tolerance: float = 0.75
    beside: float = 0.3
    averaged: tuple[float, ...] = (3.0, 2.0, 1.5)
    block: int = 40000


SETTINGS = FitSettings()
_TINY = np.float32(1e-6)


@dataclass(frozen=True, eq=False)
class SurfacePatch:
    """Cells of a surface on and around one part.

    Attributes:
        origin: (3,) float64 mean of the part's cells, map frame, metres.
        points: (n, 3) float32 about it, metres.
        own: (n,) bool: the part shows there.
        weights: (n,) float32 number of cells that each stands for.
        tolerance: difference from which heights do not agree, metres.
    """

    origin: np.ndarray
    points: np.ndarray
    own: np.ndarray
    weights: np.ndarray
    tolerance: float

    def thinned(self, count: int) -> SurfacePatch:
        """The patch with at most `count` cells on the part and as many beside it."""
        chosen: list[np.ndarray] = []
        weights: list[np.ndarray] = []
        for cells in (np.flatnonzero(self.own), np.flatnonzero(~self.own)):
            kept = min(count, len(cells))
            chosen.append(cells[np.linspace(0, len(cells) - 1, kept).astype(int)])
            weights.append(np.full(kept, len(cells) / max(kept, 1), np.float32))
        cells = np.concatenate(chosen)
        return SurfacePatch(self.origin, self.points[cells], self.own[cells],
                            np.concatenate(weights), self.tolerance)


def cut_patch(top: HeightMap, own: np.ndarray, margin: float, part_length: float) -> SurfacePatch:
    """Cuts a part and what is around it out of a surface.

    Args:
        top: the surface.
        own: (rows, cols) bool: the part shows there; where the surface is valid in some cells.
        margin: distance to the part up to which the surface is looked at, metres.
        part_length: v**(1/3), metres.
    """
    reach = int(np.ceil(margin / top.pitch))
    corners = [(max(cells.min() - reach, 0), cells.max() + reach + 1) for cells in np.nonzero(own)]
    box = tuple(slice(*ends) for ends in corners)
    heights, own = top.heights[box], own[box]
    near = ndimage.distance_transform_edt(~own) <= reach
    cells = np.nonzero(near & np.isfinite(heights))
    rows, cols = (along + first + 0.5 for along, (first, _) in zip(cells, corners))
    points = np.stack([cols * top.pitch, rows * top.pitch, heights[cells]], axis=1)
    origin = points[own[cells]].mean(axis=0)
    tolerance = max(SETTINGS.tolerance * part_length, SETTINGS.least_tolerance * top.pitch)
    return SurfacePatch(origin, (points - origin).astype(np.float32), own[cells],
                        np.ones(len(points), np.float32), tolerance)


@dataclass(frozen=True, eq=False)
class Guesses:
    """Poses of a part, each one of its views turned about the vertical and shifted.

    Attributes:
        view: (m,) int of each, a row of `PartViews.rotations`.
        turn: (m,) float64 angle from the view's axes to those of the map, rad.
        shift: (m, 2) float64 x and y of the part's `center`, about the patch's origin, metres.
        rise: (m,) float64 its height, the same; 0 before it is judged.
        fit: (m,) float64 how well the mesh explains the surface, 0 to 1; 0 before it is judged.
    """

    view: np.ndarray
    turn: np.ndarray
    shift: np.ndarray
    rise: np.ndarray
    fit: np.ndarray

    def __len__(self) -> int:
        return len(self.view)

    def __getitem__(self, rows: np.ndarray | slice) -> Guesses:
        return Guesses(self.view[rows], self.turn[rows], self.shift[rows], self.rise[rows],
                       self.fit[rows])

    def poses(self, views: PartViews) -> np.ndarray:
        """(m, 4, 4) float64 poses of the mesh about its `center`, about the patch's origin."""
        cos, sin = np.cos(self.turn), np.sin(self.turn)
        turned = np.zeros((len(self), 3, 3))
        turned[:, 0, 0], turned[:, 0, 1], turned[:, 1, 0], turned[:, 1, 1] = cos, -sin, sin, cos
        turned[:, 2, 2] = 1
        places = np.column_stack([self.shift, self.rise])
        return np.stack([geometry.pose(R, place)
                         for R, place in zip(turned @ views.rotations[self.view], places)])


def guess_everywhere(views: PartViews, turns: int) -> Guesses:
    """All views at evenly spread turns, the middle of what each covers on the patch's origin."""
    view: np.ndarray = np.repeat(np.arange(len(views.rotations)), turns)
    turn = np.tile(2 * np.pi * np.arange(turns) / turns, len(views.rotations))
    x, y = views.middles()[view].T
    shift = -np.stack([np.cos(turn) * x - np.sin(turn) * y, np.sin(turn) * x + np.cos(turn) * y],
                      axis=1)
    return Guesses(view, turn, shift, np.zeros(len(view)), np.zeros(len(view)))


def guesses_from_poses(poses: np.ndarray) -> Guesses:
    """Of (m, 4, 4) poses of views that are made for them: view i has the rotation of pose i."""
    none = np.zeros(len(poses))
    return Guesses(np.arange(len(poses)), none, poses[:, :2, 3], poses[:, 2, 3], none)


def move_to_best(views: PartViews, guesses: Guesses, patch: SurfacePatch, steps: np.ndarray
                 ) -> Guesses:
    """The same guesses, each after the best of some motions, judged.

    Args:
        views: that the guesses are of.
        guesses: poses to move.
        patch: to judge by.
        steps: (n, 3) x and y, metres, and turn about the vertical, rad, of each motion.
    """
    every = guesses[np.repeat(np.arange(len(guesses)), len(steps))]
    shift = (guesses.shift[:, None] + steps[:, :2]).reshape(-1, 2)
    turn = (guesses.turn[:, None] + steps[:, 2]).ravel()
    judged = judge(views, Guesses(every.view, turn, shift, every.rise, every.fit), patch)
    best = judged.fit.reshape(-1, len(steps)).argmax(axis=1)
    return judged[best + len(steps) * np.arange(len(guesses))]


def grid_of_steps(shift: float, shifts: int, turn: float, turns: int) -> np.ndarray:
    """(n, 3) all motions by up to so many steps to either side: metres, metres and rad."""
    along, about = (np.arange(-n, n + 1) * step for n, step in ((shifts, shift), (turns, turn)))
    return np.stack(np.meshgrid(along, along, about), axis=-1).reshape(-1, 3)


def judge(views: PartViews, guesses: Guesses, patch: SurfacePatch) -> Guesses:
    """The same guesses with their fit, at the height at which the mesh agrees best."""
    block = max(SETTINGS.block // len(patch.points), 1)
    judged = [_judge_block(views, guesses[i:i + block], patch)
              for i in range(0, len(guesses), block)]
    rise, fit = (np.concatenate(part).astype(float) for part in zip(*judged))
    return Guesses(guesses.view, guesses.turn, guesses.shift, rise, fit)


def _judge_block(views: PartViews, guesses: Guesses, patch: SurfacePatch
                 ) -> tuple[np.ndarray, np.ndarray]:
    """(m,) rises and (m,) fits of some guesses."""
    tolerance = np.float32(patch.tolerance)
    mesh = _read_heights(views, guesses, patch.points)
    covered = np.isfinite(mesh)
    above = np.where(covered, mesh - patch.points[:, 2], 0)  # of the mesh over the surface
    # Raise the mesh to where most of the part's cells agree with it.
    used = patch.weights * patch.own * covered
    rise = _weighted_mean(used, -above, 0)
    for width in SETTINGS.averaged:
        near = used * (np.abs(above + rise[:, None]) < width * tolerance)
        rise = _weighted_mean(near, -above, rise)
    above += rise[:, None]
    # What is explained, of what the part shows and what the mesh would show beside it.
    agreement = np.maximum(1 - (above / tolerance) ** 2, 0) * used
    beside = np.where(above > tolerance, 1, np.float32(SETTINGS.beside) * (above > -tolerance))
    wrong = beside * (patch.weights * ~patch.own * covered)
    total = patch.weights[patch.own].sum() + wrong.sum(axis=1)
    return rise, agreement.sum(axis=1) / total


def _read_heights(views: PartViews, guesses: Guesses, points: np.ndarray) -> np.ndarray:
    """(m, n) float32 heights of each guess, not raised, at (n, 3) points; NaN beside the part."""
    side = views.heights.shape[-1]
    # Turn the points back into the view's axes, and measure them in its cells.
    cos, sin = (along.astype(np.float32)[:, None] / np.float32(views.pitch)
                for along in (np.cos(guesses.turn), np.sin(guesses.turn)))
    x, y = (points[:, axis] - guesses.shift[:, axis, None].astype(np.float32) for axis in (0, 1))
    cols, rows = (np.clip((along + np.float32(side / 2)).astype(np.int32), 0, side - 1)
                  for along in (cos * x + sin * y, cos * y - sin * x))
    first = (guesses.view * side**2).astype(np.int32)[:, None]
    return views.heights.ravel()[first + rows * side + cols]


def _weighted_mean(weights: np.ndarray, values: np.ndarray, otherwise: np.ndarray | float
                   ) -> np.ndarray:
    """(m,) means along the rows; where all weights are 0, another value."""
    total = weights.sum(axis=1)
    return np.where(total > 0, (weights * values).sum(axis=1) / np.maximum(total, _TINY),
                    otherwise)
