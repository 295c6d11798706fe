# SPDX-License-Identifier: Apache-2.0
"""Fits a container's wall to the faces that cameras see: the outer one and the inner one.

A camera that looks into a bin from the side sees the near wall from outside and the far wall from
inside. Both are smooth surfaces with thousands of points, so their fit is far better than the
noise of a point and knows nothing of how edges look in a depth image.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np
from scipy.optimize import least_squares

from stack_counter import geometry
from stack_counter.container.silhouettes import WallOutlines
from stack_counter.fusion.region import Region
from stack_counter.types import View, WallShape, spread_views

Shape = TypeVar("Shape", bound=WallShape)


@dataclass(frozen=True)
class WallFitSettings:
    """Which points count as a wall's, and how its fit runs; all values are chosen.

    Attributes:
        max_views: largest number of views used, evenly spread over the scan.
        max_points: largest number of points in the fit, evenly chosen.
        max_view_points: largest number of points of a view that may lie on a wall, evenly
            chosen.
        edge: strip below the rim whose points are of neither face, m.
        reach: distance from where a face is expected within which points may be its, m.
        noise_reach: the same in standard deviations of a depth point.
        foot: height above the support plane below which points are not used, m.
        sectors: cells of the wall around the container; each cell gives one median point.
        slabs: cells of the wall from the rim down.
        min_cell_points: least number of points of a cell that shows the wall.
        max_cell_spread: largest quartile distance of such a cell's points, over the reach.
        cell_std: standard deviation of a cell's median, m.
        min_foot_share: least width of the foot, over that of the rim: containers stand, so below
            what is seen a wall does not close to a point.
        foot_share_std: standard deviation of that bound.
        max_steps: largest number of steps of a fit, which takes 4 to 13; one that needs more does
            not fit.
        outline_prior_weight: weight of an outline's first guess, over that of one standard
            deviation; only for parameters that the rim does not determine, e.g. the draft.
        depth_shares: shares of the height that are fitted, one for each round.
        outline_std: standard deviation of an outline in label images, m.
        outline_weight: weight of a point of such an outline, over that of a cell's median.
    """

    max_views: int = 24
    max_points: int = 60_000
    max_view_points: int = 10_000
    edge: float = 0.003
    reach: float = 0.0025
    noise_reach: float = 1.5
    foot: float = 0.002
    sectors: int = 72
    slabs: int = 12
    min_cell_points: int = 4
    max_cell_spread: float = 0.8
    cell_std: float = 0.001
    min_foot_share: float = 0.35
    foot_share_std: float = 0.02
    max_steps: int = 60
    outline_prior_weight: float = 0.01
    depth_shares: tuple[float, ...] = (0.15, 0.3, 0.5, 0.75, 1.0, 1.0)
    outline_std: float = 0.001
    outline_weight: float = 3.0


SETTINGS = WallFitSettings()
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class FacePoints:
    """Points that may lie on a wall.

    Attributes:
        xy: (n, 2) metres, world.
        below: (n,) metres below the rim.
        inner: (n,) bool: seen from inside, else from outside.
    """

    xy: np.ndarray
    below: np.ndarray
    inner: np.ndarray

    def select(self, chosen: np.ndarray) -> FacePoints:
        """The points of a mask or of indices."""
        return FacePoints(self.xy[chosen], self.below[chosen], self.inner[chosen])


@dataclass(frozen=True)
class Thickness:
    """Thickness of a wall and its standard deviation, metres, measured horizontally."""

    mean: float
    std: float


@dataclass(frozen=True, eq=False)
class FittedWall:
    """A fitted wall.

    Attributes:
        shape: its outer face.
        thickness: metres, measured horizontally.
        outer_share: share of the sectors around it that showed the outer face.
        inner_share: share of the sectors around it that showed the inner face.
        spread: robust standard deviation of the points around it, metres.
    """

    shape: WallShape
    thickness: float
    outer_share: float = 0.0
    inner_share: float = 0.0
    spread: float = 0.0

    @property
    def best_face_share(self) -> float:
        """Share of the sectors that showed the face which more of them showed."""
        return max(self.outer_share, self.inner_share)


def find_face_points(views: list[View], region: Region, shape: WallShape, height: float
                     ) -> FacePoints:
    """The points that the views saw on the near wall from outside or beyond it from inside.

    Args:
        views: with depth.
        region: where the container stands.
        shape: first guess of the outer face.
        height: of the rim above the support plane, metres.
    """
    s = SETTINGS
    found = [_face_points_in_view(view, region, shape, height)
             for view in spread_views(views, s.max_views)]
    every = FacePoints(*(np.concatenate([getattr(f, name) for f in found])
                         for name in ("xy", "below", "inner")))
    return every.select(np.arange(0, len(every.inner), len(every.inner) // s.max_points + 1))


def _face_points_in_view(view: View, region: Region, shape: WallShape, height: float
                         ) -> FacePoints:
    """The `face_points` of one view."""
    s = SETTINGS
    # Crop to the region between foot and rim.
    points = geometry.world_points(view).reshape(-1, 3)
    z = points[:, 2] - region.plane_z
    points = points[(z > s.foot) & (z < height - s.edge) & region.contains(points)]
    points = points[::len(points) // s.max_view_points + 1]
    below = height - (points[:, 2] - region.plane_z)
    # Direction of each ray towards the wall's outside, and how far inside the rim it ends.
    ray = points - view.T_world_camera[:3, 3].astype(np.float32)
    outwards = np.sum(ray[:, :2] * shape.outward_normals(points[:, :2]), axis=1)
    inside = shape.depth_inside(points[:, :2], np.zeros(len(points)))
    # How far below the rim the ray was where it crossed the rim's outline.
    crossed = below + np.maximum(inside, 0) / np.maximum(np.abs(outwards), 1e-6) * ray[:, 2]
    # Split into the two faces.
    outer = (outwards < 0) & (crossed > s.edge)
    inner = (outwards > 0) & (inside > -s.reach)
    kept = outer | inner
    return FacePoints(points[kept, :2].astype(float), below[kept].astype(float), inner[kept])


def fit_outline(shape: Shape, xy: np.ndarray, scale: float) -> Shape:
    """Fits a shape whose rim runs through points, few of which may be far off.

    Args:
        shape: first guess.
        xy: (n, 2) points of the rim, world, metres.
        scale: their standard deviation, metres.
    """
    s, level = SETTINGS, np.zeros(len(xy))

    def residuals(params: np.ndarray) -> np.ndarray:
        # What the rim does not determine, e.g. the draft, stays as it was.
        return np.append(shape.with_params(params).depth_inside(xy, level) / scale,
                         s.outline_prior_weight * (params - shape.params) / shape.prior_std)
    return shape.with_params(least_squares(
        residuals, shape.params, loss="soft_l1", x_scale=shape.prior_std,
        max_nfev=s.max_steps).x)


def fit_wall(shape: WallShape, points: FacePoints, height: float, thickness: Thickness,
             noise: float, outlines: WallOutlines | None = None) -> FittedWall:
    """Fits outer face and thickness at once, from the rim downwards, by robust least squares.

    Args:
        shape: first guess.
        points: of both faces, with others among them.
        height: of the rim above the support plane, metres.
        thickness: known before the fit.
        noise: standard deviation of a depth point, metres.
        outlines: in label images, that the wall is fitted to beside its outer face alone; None
            for depth cameras, which measure both faces.
    """
    s = SETTINGS
    wall = FittedWall(shape, thickness.mean)
    cell = _cell_indices(shape, points, height)
    reach = max(s.reach, s.noise_reach * noise)
    # Fit a growing part of the wall, from the rim down.
    for share in s.depth_shares:
        chosen = _cell_medians(wall, points, cell, reach, points.below < share * height)
        if outlines is not None:
            chosen = chosen[~points.inner[chosen]]
        wall = _refine_fit(wall, points.select(chosen), shape, thickness, height, outlines)
    # Which sectors showed which face, and how well they agree.
    chosen = _cell_medians(wall, points, cell, reach, np.ones(len(points.below), bool))
    medians = points.select(chosen)
    distances = np.abs(_residuals(wall, medians))
    sector = cell[chosen] // (2 * s.slabs)
    shares = [len(np.unique(sector[face])) / s.sectors for face in (~medians.inner,
                                                                    medians.inner)]
    return replace(
        wall, outer_share=shares[0], inner_share=shares[1],
        spread=_MAD_TO_STD * float(np.median(distances)) if len(distances) else np.inf)


def _cell_indices(shape: WallShape, points: FacePoints, height: float) -> np.ndarray:
    """(n,) index of the cell of the wall that each point lies in: sector, face and slab."""
    s = SETTINGS
    offsets = points.xy - shape.center
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) % 1
    sector = np.minimum((turn * s.sectors).astype(int), s.sectors - 1)
    slab = np.clip((points.below / height * s.slabs).astype(int), 0, s.slabs - 1)
    return (sector * 2 + points.inner) * s.slabs + slab


def _cell_medians(wall: FittedWall, points: FacePoints, cell: np.ndarray, reach: float,
                  allowed: np.ndarray) -> np.ndarray:
    """Indices of the median point of every cell that shows the wall.

    Parts hide the inner face from some depth on: of a sector only the cells down to the first
    that does not show it count.
    """
    s = SETTINGS
    # Sort the points near the wall by cell and distance; the middle of each run is its median.
    distance = _residuals(wall, points)
    near = np.nonzero(allowed & (np.abs(distance) < reach))[0]
    order = near[np.lexsort((distance[near], cell[near]))]
    cells, first, count = np.unique(cell[order], return_index=True, return_counts=True)
    median = order[first + count // 2]
    # Cells with enough points that lie close together.
    spread = distance[order[first + 3 * count // 4]] - distance[order[first + count // 4]]
    shows = np.zeros(s.sectors * 2 * s.slabs, bool)
    shows[cells] = (count >= s.min_cell_points) & (spread < s.max_cell_spread * reach)
    # On the inner face, cut each sector at the first gap.
    faces = shows.reshape(s.sectors, 2, s.slabs)
    top = faces[:, 1].argmax(axis=1)[:, None]  # noise may hide the first cells below the rim
    broken = ~faces[:, 1] & (np.arange(s.slabs) > top)
    faces[:, 1] &= ~np.logical_or.accumulate(broken, axis=1)
    return median[faces.ravel()[cells]]


def _refine_fit(wall: FittedWall, points: FacePoints, first: WallShape, thickness: Thickness,
                height: float, outlines: WallOutlines | None) -> FittedWall:
    """The wall after one more least-squares fit; `first` and `thickness` are expected of it."""
    s = SETTINGS
    std = np.append(first.prior_std, thickness.std)
    expected = np.append(first.params, thickness.mean)

    def residuals(params: np.ndarray) -> np.ndarray:
        moved = FittedWall(first.with_params(params[:-1]), params[-1])
        foot_share = np.ptp(moved.shape.ring(height, 0.0)[:, 0]) \
            / np.ptp(moved.shape.ring(0.0, 0.0)[:, 0])
        return np.concatenate([_soft_l1(_residuals(moved, points) / s.cell_std),
                               (params - expected) / std,
                               [] if outlines is None else s.outline_weight * _soft_l1(
                                   outlines.errors(moved.shape) / s.outline_std),
                               [min(foot_share - s.min_foot_share, 0.0) / s.foot_share_std]])
    best = least_squares(residuals, np.append(wall.shape.params, wall.thickness), x_scale=std,
                         max_nfev=s.max_steps).x
    return FittedWall(first.with_params(best[:-1]), max(float(best[-1]), 0.0))


def _soft_l1(errors: np.ndarray) -> np.ndarray:
    """Residuals whose squares grow only linearly for large errors: some points are not walls."""
    return np.sign(errors) * np.sqrt(2 * (np.sqrt(1 + errors**2) - 1))


def _residuals(wall: FittedWall, points: FacePoints) -> np.ndarray:
    """(n,) metres that points lie inside the face they were seen on."""
    return wall.shape.depth_inside(points.xy, points.below) - wall.thickness * points.inner
