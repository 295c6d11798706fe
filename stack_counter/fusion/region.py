# SPDX-License-Identifier: Apache-2.0
"""Region of interest: the support plane and what stands on it, from the first views of a scan."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.fusion.support import SETTINGS as SUPPORT_SETTINGS
from stack_counter.fusion.support import find_support_plane
from stack_counter.types import View


@dataclass(frozen=True)
class RegionSettings:
    """How the support plane and what stands on it are told apart; all values are chosen.

    Attributes:
        stride: pixels from one point that is used to the next.
        min_points: least number of depth points in sight.
        cell: side of a cell of the map in which blobs are told apart, m.
        join_cells: distance, cells, up to which things belong to one blob.
        min_cell_points: least number of points in a cell whose mean height is used.
        min_height: least height above the plane of what is looked at, m.
        noise_factor: the same in standard deviations of single points.
        cell_noise_factor: the same in standard deviations of the cells' mean heights.
        margin: plane kept around the blob, m: the container's foot and some support.
        growth: farthest that one view can grow the region, m.
        min_piece_share: least number of points of a piece on a table, over that of the largest.
        widest: most that a scan shows along an axis, m: a camera sees a few metres.
        one_side_angle: largest angle between the directions to all cameras of a scan from one
            side, rad.
    """

    stride: int = 4
    min_points: int = 100
    cell: float = 0.005
    join_cells: int = 4
    min_cell_points: int = 3
    min_height: float = 0.006
    noise_factor: float = 4.0
    cell_noise_factor: float = 5.0
    margin: float = 0.04
    growth: float = 0.1
    min_piece_share: float = 0.1
    widest: float = 50.0
    one_side_angle: float = 0.35


SETTINGS = RegionSettings()
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class Region:
    """An upright box in the world.

    Attributes:
        low, high: (3,) corners, metres.
        plane_z: height of the support plane, metres.
        noise: standard deviation of single depth points around that plane, metres.
        support_certain: False if that plane may be level parts, as no support is in sight.
        configured: given by the settings, so that nothing beyond it is counted.
        stereo_window_m: side of the windows that stereo compared, metres; 0: a depth camera.
    """

    low: np.ndarray
    high: np.ndarray
    plane_z: float
    noise: float
    support_certain: bool = True
    configured: bool = False
    stereo_window_m: float = 0.0

    @property
    def noise_height(self) -> float:
        """Height above the plane, metres, below which a single point may be noise."""
        return max(SETTINGS.min_height, SETTINGS.noise_factor * self.noise)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(...) bool for (..., 3) world points, metres."""
        x, y, z = np.moveaxis(points, -1, 0)  # axis by axis: several times faster than all at once
        (x0, y0, z0), (x1, y1, z1) = self.low.tolist(), self.high.tolist()
        return ((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1) & (z >= z0) & (z <= z1))

    def union(self, other: Region) -> Region:
        """The smallest region around both, with the support plane of this one."""
        return replace(self, low=np.minimum(self.low, other.low),
                       high=np.maximum(self.high, other.high))

    def grown_by(self, view: View) -> Region:
        """The region extended by what a view with depth shows standing across its border.

        Raises:
            ViewError: reason `no_depth`.
        """
        s = SETTINGS
        points = geometry.world_points(view, s.stride).reshape(-1, 3)
        # What stands near the region, if it reaches into it.
        around = replace(self, low=self.low - s.growth, high=self.high + s.growth)
        blob = largest_blob(_standing_points(points[around.contains(points)], self))
        if not len(blob) or not self.contains(blob).any():
            return self
        return self.union(_region_around(blob, self))


def find_region(views: list[View], config: ReconstructorConfig) -> Region:
    """Finds the support plane and the largest thing that stands on it.

    The plane is the horizontal one with the most area in sight (z is up in the world), the
    configured one, or the one below a configured region; the blob is the connected footprint with
    the most points above it.

    Args:
        views: first views of the scan, with depth.
        config: a configured region (`roi_size_m`) is used as given and says what is counted; the
            plane is found in all that is seen, unless `support_height_m` says where it is.

    Raises:
        ScanError: no plane, or nothing in sight.
    """
    points = _depth_points(views)
    configured = any(config.roi_size_m)
    center, size = np.array(config.roi_center_m), np.array(config.roi_size_m)
    low, high = center - size / 2, center + size / 2
    inside = points[np.all((points >= low) & (points <= high), axis=1)] if configured else points
    if len(inside) < SETTINGS.min_points:
        raise ScanError(f"{len(inside)} depth points in the region of interest; "
                        f"expected {SETTINGS.min_points} or more")
    width = np.ptp(points, axis=0).max()
    if not configured and width > SETTINGS.widest:
        raise ScanError(f"the views show things {width:.0f} m apart; expected below "
                        f"{SETTINGS.widest:g} m: publish poses in metres, or set a region of "
                        "interest (roi_size_m)")
    # Find the support plane.
    plane = find_support_plane(points, config.support_height_m,
                               *((low, high) if configured else ()))
    everything = Region(points.min(axis=0), points.max(axis=0), plane.height,
                        min(plane.noise, _noise_of_views(views, plane.height)),
                        plane.is_certain, configured)
    if configured:
        low[2] = min(low[2], plane.height - SETTINGS.margin)
        return replace(everything, low=low, high=high)
    # Find the largest blob that stands on it.
    blob = largest_blob(_standing_points(points, everything))
    return _region_around(blob, everything) if len(blob) else everything


def find_region_again(views: list[View], region: Region) -> Region:
    """Finds the largest thing in a region once poses are right: its support plane is known.

    Args:
        views: with depth.
        region: as found before; returned where nothing stands in it.
    """
    blob = largest_blob(_standing_points(_depth_points(views), region))
    return _region_around(blob, region) if len(blob) else region


def find_pieces(views: list[View], config: ReconstructorConfig) -> Region:
    """Finds the support plane and all pieces that lie apart on it.

    Args:
        views: views of the scan, with depth.
        config: a configured region (`roi_size_m`) is used as given.

    Raises:
        ScanError: no plane, nothing in sight, or nothing stands on the plane.
    """
    region = find_region(views, config)
    if np.any(config.roi_size_m):
        return region
    standing = _standing_points(_depth_points(views), region)
    footprints = _label_footprints(standing)
    if len(standing):  # what is much smaller than the largest is noise of far ground
        counts = footprints.counts
        large = counts > SETTINGS.min_piece_share * counts.max()
        standing = standing[large[footprints.label_of_point]]
    if not len(standing):
        raise ScanError("nothing stands on the support plane; expected pieces that lie apart")
    return _region_around(standing, region)


def seen_from_one_side(views: list[View], region: Region) -> bool:
    """Whether the directions from the region's middle to all cameras are nearly the same."""
    middle = (region.low + region.high) / 2
    directions = np.array([v.T_world_camera[:3, 3] for v in views]) - middle
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    angles = np.arccos(np.clip(directions @ directions[0], -1, 1))
    return bool(angles.max() < SETTINGS.one_side_angle)


def crop_to_region(view: View, region: Region) -> View:
    """Crops a view to the pixels that can show something of the region.

    Raises:
        ViewError: reason `out_of_sight`, if there are none.
    """
    corners = np.array(np.meshgrid(*zip(region.low, region.high))).reshape(3, 8).T
    local = geometry.apply(geometry.inverse(view.T_world_camera), corners)
    if np.any(local[:, 2] < 0.01):  # the camera is inside or beside it: the whole image may
        return view
    pixels, _ = geometry.project(local, view.intrinsics)
    return geometry.crop(view, pixels.min(axis=0), pixels.max(axis=0))


def find_blobs(points: np.ndarray) -> list[np.ndarray]:
    """Splits (n, 3) world points by connected footprints, those with the most points first."""
    footprints = _label_footprints(points)
    order = np.argsort(-footprints.counts, kind="stable")
    return [points[footprints.label_of_point == label] for label in order
            if footprints.counts[label]]


def largest_blob(points: np.ndarray) -> np.ndarray:
    """The world points, of (n, 3), of the connected footprint that holds the most of them."""
    return find_blobs(points)[0] if len(points) else points


def _depth_points(views: Iterable[View]) -> np.ndarray:
    """(n, 3) float32 world points of views with depth, metres."""
    return np.concatenate([p[np.isfinite(p[:, 2])] for p in (
        geometry.world_points(view, SETTINGS.stride).reshape(-1, 3) for view in views)])


def _standing_points(points: np.ndarray, region: Region) -> np.ndarray:
    """Those of (n, 3) world points that stand on the plane, alone or with their neighbours."""
    s = SETTINGS
    above = points[:, 2] - region.plane_z
    if not len(points):
        return points
    # Mean height of the points in each cell of a map.
    cells = np.floor(points[:, :2] / s.cell).astype(np.int64)
    cells -= cells.min(axis=0)
    cell = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    count = np.bincount(cell)
    mean = np.bincount(cell, above) / np.maximum(count, 1)
    # Noise of these means on the ground, where nothing stands.
    ground = (np.abs(mean) < region.noise_height) & (count > 0)
    noise = _MAD_TO_STD * np.median(np.abs(mean[ground])) if ground.any() else region.noise
    high = (mean > max(s.min_height / 2, s.cell_noise_factor * noise)) \
        & (count >= s.min_cell_points)
    return points[(above > region.noise_height) | (high[cell] & (above > 0))]


def _region_around(blob: np.ndarray, region: Region) -> Region:
    """The region that holds (n, 3) points, the support plane below them, and a margin."""
    low = np.append(blob[:, :2].min(axis=0), region.plane_z)
    return replace(region, low=low - SETTINGS.margin, high=blob.max(axis=0) + SETTINGS.margin)


def _noise_of_views(views: list[View], plane_z: float) -> float:
    """Noise of points around the plane that each view shows for itself, m; infinite for too few.

    Poses that are off put these planes at other heights and slopes, which is no noise of depth.
    """
    deviations = []
    for view in views:
        points = _depth_points([view]).astype(float)
        near = points[np.abs(points[:, 2] - plane_z) < SUPPORT_SETTINGS.plane_reach]
        if len(near) >= SETTINGS.min_points:
            design = np.column_stack([np.ones(len(near)), near[:, :2]])
            rest = near[:, 2] - design @ np.linalg.lstsq(design, near[:, 2], rcond=None)[0]
            deviations.append(float(np.median(np.abs(rest - np.median(rest)))))
    return _MAD_TO_STD * float(np.median(deviations)) if deviations else float("inf")


@dataclass(frozen=True, eq=False)
class _Footprints:
    """Connected footprints of n points.

    Attributes:
        label_of_point: (n,) int, the footprint that each point is in, from 1 on.
        counts: (k,) int, how many points each label has; label 0 has none.
    """

    label_of_point: np.ndarray
    counts: np.ndarray


def _label_footprints(points: np.ndarray) -> _Footprints:
    """Labels (n, 3) world points by the connected footprint that they are in."""
    if not len(points):
        return _Footprints(np.zeros(0, np.int64), np.zeros(1, np.int64))
    # Count the points in each cell of a map.
    cells = np.floor(points[:, :2] / SETTINGS.cell).astype(np.int64)
    cells -= cells.min(axis=0)
    counts = np.zeros(cells.max(axis=0) + 1, np.int64)
    np.add.at(counts, (cells[:, 0], cells[:, 1]), 1)
    # Joins the rim and the parts over the unseen strip between them, and parts beside a heap.
    filled = ndimage.binary_dilation(counts > 0, iterations=SETTINGS.join_cells)
    labels, _ = ndimage.label(filled, structure=np.ones((3, 3)))
    label_of_point = labels[cells[:, 0], cells[:, 1]]
    return _Footprints(label_of_point, np.bincount(label_of_point))
