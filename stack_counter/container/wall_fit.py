"""Fits a container's wall to the faces that cameras see: the outer one and the inner one.

A camera that looks into a bin from the side sees the near wall from outside and the far wall from
inside. Both are smooth surfaces with thousands of points, so their fit is far better than the
noise of a point and knows nothing of how edges look in a depth image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.optimize import least_squares

from stack_counter import geometry
from stack_counter.container.wall_shapes import WallShape
from stack_counter.fusion.region import Region
from stack_counter.types import View

_MOST_VIEWS = 24  # looked at, evenly spread over the scan
_MOST_POINTS = 60_000  # in the fit, evenly chosen
_EDGE = 0.003  # next to the rim, where points are neither face, m
_REACH = 0.0025  # of a face on both sides of where it is thought to be, m
_FOOT = 0.002  # above the support plane, m
_SECTORS, _SLABS = 72, 12  # cells of the wall, around and down; each gives one median point
_FEWEST = 4  # points of a cell that shows the wall
_CELL_ERROR = 0.001  # standard deviation of a cell's median, m
# Containers stand: below what is seen, a wall does not close to a foot narrower than this share
# of the rim, give or take.
_FOOT_SHARE, _FOOT_STD = 0.35, 0.02
_FIT_STEPS = 60  # of a form's fit; one that needs more does not fit
_ROUNDS = (0.15, 0.3, 0.5, 0.75, 1.0, 1.0)  # share of the height that is fitted


@dataclass(frozen=True)
class FacePoints:
    """Points that may lie on a wall: (n, 2) world metres, (n,) metres below the rim, and
    (n,) bool: seen from inside (else from outside)."""

    xy: np.ndarray
    below: np.ndarray
    inner: np.ndarray

    def chosen(self, which: np.ndarray) -> FacePoints:
        """Those of a mask or of indices."""
        return FacePoints(self.xy[which], self.below[which], self.inner[which])


@dataclass(frozen=True)
class Wall:
    """A fitted wall.

    Attributes:
        form: its outer face.
        thickness: horizontal, metres.
        outer_share, inner_share: of 36 sectors around it, that showed the outer (inner) face.
        spread: robust standard deviation of the points around it, metres.
    """

    form: WallShape
    thickness: float
    outer_share: float = 0.0
    inner_share: float = 0.0
    spread: float = 0.0


def face_points(views: list[View], region: Region, form: WallShape, height: float) -> FacePoints:
    """The points that the views saw on the near wall from outside or beyond it from inside.

    Args:
        views: with depth.
        region: where the container stands.
        form: first guess of the outer face.
        height: of the rim above the support plane, metres.
    """
    found = []
    chosen = np.unique(np.linspace(0, len(views) - 1, _MOST_VIEWS).round().astype(int))
    for view in (views[i] for i in chosen):
        points = geometry.world_points(view).reshape(-1, 3)
        z = points[:, 2] - region.plane_z
        points = points[region.contains(points) & (z > _FOOT) & (z < height - _EDGE)]
        below = height - (points[:, 2] - region.plane_z)
        ray = points - view.T_world_camera[:3, 3].astype(np.float32)
        outwards = np.sum(ray[:, :2] * form.outward(points[:, :2]), axis=1)
        inside = form.depth_inside(points[:, :2], np.zeros(len(points)))
        # How far below the rim the ray was where it crossed the rim's outline.
        crossed = below + np.maximum(inside, 0) / np.maximum(np.abs(outwards), 1e-6) * ray[:, 2]
        outer = (outwards < 0) & (crossed > _EDGE)
        inner = (outwards > 0) & (inside > -_REACH)
        keep = outer | inner
        found.append(FacePoints(points[keep, :2].astype(float), below[keep].astype(float),
                                inner[keep]))
    every = FacePoints(*(np.concatenate([getattr(f, name) for f in found])
                         for name in ("xy", "below", "inner")))
    return every.chosen(np.arange(0, len(every.inner), len(every.inner) // _MOST_POINTS + 1))


def fit_outline(form: WallShape, xy: np.ndarray, scale: float) -> WallShape:
    """The form whose rim runs through (n, 2) world points; few of them may be far off."""
    level = np.zeros(len(xy))

    def misses(params: np.ndarray) -> np.ndarray:
        # What the rim says nothing about, e.g. the draft, stays as it was.
        return np.append(form.with_params(params).depth_inside(xy, level) / scale,
                         0.01 * (params - form.params) / form.params_std)
    return form.with_params(least_squares(misses, form.params, loss="soft_l1",
                                          x_scale=form.params_std, max_nfev=_FIT_STEPS).x)


def fit_wall(form: WallShape, points: FacePoints, height: float, thickness: float,
             thickness_std: float, noise: float) -> Wall:
    """Outer face and thickness at once, from the rim downwards, by robust least squares.

    Args:
        form: first guess.
        points: of both faces, with others among them.
        height: of the rim above the support plane, metres.
        thickness, thickness_std: what is known of it beforehand, metres.
        noise: of a depth point, metres.
    """
    wall = Wall(form, thickness)
    cell = _cells(form, points, height)
    reach = max(_REACH, 1.5 * noise)
    for share in _ROUNDS:
        middle = _cell_medians(wall, points, cell, reach, points.below < share * height)
        wall = _refined(wall, points.chosen(middle), form, (thickness, thickness_std), height)
    middle = _cell_medians(wall, points, cell, reach, np.ones(len(points.below), bool))
    seen = points.chosen(middle)
    miss = np.abs(_residuals(wall, seen))
    sector = cell[middle] // (2 * _SLABS)
    shares = [len(np.unique(sector[face])) / _SECTORS for face in (~seen.inner, seen.inner)]
    return replace(wall, outer_share=shares[0], inner_share=shares[1],
                   spread=1.4826 * float(np.median(miss)) if len(miss) else np.inf)


def _cells(form: WallShape, points: FacePoints, height: float) -> np.ndarray:
    """(n,) which cell of the wall a point lies in: sector, face and slab."""
    away = points.xy - form.pose[0]
    turn = np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) % 1
    sector = np.minimum((turn * _SECTORS).astype(int), _SECTORS - 1)
    slab = np.clip((points.below / height * _SLABS).astype(int), 0, _SLABS - 1)
    return (sector * 2 + points.inner) * _SLABS + slab


def _cell_medians(
    wall: Wall, points: FacePoints, cell: np.ndarray, reach: float, allowed: np.ndarray
) -> np.ndarray:
    """Indices of the median point of every cell that shows the wall.

    Parts hide the inner face from some depth on: of a sector only the cells down to the first
    that does not show it count.
    """
    miss = _residuals(wall, points)
    near = np.nonzero(allowed & (np.abs(miss) < reach))[0]
    order = near[np.lexsort((miss[near], cell[near]))]
    names, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    middle = order[first + count // 2]
    spread = miss[order[first + 3 * count // 4]] - miss[order[first + count // 4]]
    shows = np.zeros(_SECTORS * 2 * _SLABS, bool)
    shows[names] = (count >= _FEWEST) & (spread < 0.8 * reach)
    faces = shows.reshape(_SECTORS, 2, _SLABS)
    top = faces[:, 1].argmax(axis=1)[:, None]  # noise may hide the first cells below the rim
    broken = ~faces[:, 1] & (np.arange(_SLABS) > top)
    faces[:, 1] &= ~np.logical_or.accumulate(broken, axis=1)
    return middle[faces.ravel()[names]]


def _refined(wall: Wall, points: FacePoints, first: WallShape, prior: tuple[float, float],
             height: float) -> Wall:
    std = np.append(first.params_std, prior[1])
    expected = np.append(first.params, prior[0])

    def misses(params: np.ndarray) -> np.ndarray:
        moved = Wall(first.with_params(params[:-1]), params[-1])
        foot = np.ptp(moved.form.ring(height, 0.0)[:, 0]) / np.ptp(moved.form.ring(0.0, 0.0)[:, 0])
        return np.concatenate([_soft_l1(_residuals(moved, points) / _CELL_ERROR),
                               (params - expected) / std,
                               [min(foot - _FOOT_SHARE, 0.0) / _FOOT_STD]])
    best = least_squares(misses, np.append(wall.form.params, wall.thickness), x_scale=std).x
    return Wall(first.with_params(best[:-1]), max(float(best[-1]), 0.0))


def _soft_l1(errors: np.ndarray) -> np.ndarray:
    """Residuals whose squares grow only linearly for large errors: some points are not walls."""
    return np.sign(errors) * np.sqrt(2 * (np.sqrt(1 + errors**2) - 1))


def _residuals(wall: Wall, points: FacePoints) -> np.ndarray:
    """(n,) metres that points lie inside the face they were seen on."""
    return wall.form.depth_inside(points.xy, points.below) - wall.thickness * points.inner
