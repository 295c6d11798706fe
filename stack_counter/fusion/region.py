"""Region of interest: the support plane and what stands on it, from the first views of a scan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.types import View

_CELL = 0.005  # side of a cell of the map in which blobs are told apart, m
_JOINED = 4  # cells around a thing in which another one belongs to it
_FEWEST = 3  # points of a cell whose mean height counts
_STRIDE = 4  # pixels between the points looked at
_LOWEST = 0.006  # what stands less than this above the plane is never looked at, m
_GROWTH = 0.1  # farthest that one view can grow the region, m
_PIECE = 0.1  # least points of a piece on a table, over those of the largest
MARGIN = 0.04  # plane kept around the blob: the container's foot and some support, m


@dataclass(frozen=True)
class Region:
    """An upright box in the world.

    Attributes:
        low, high: (3,) metres.
        plane_z: height of the support plane, metres.
        noise: standard deviation of single depth points around that plane, metres.
    """

    low: np.ndarray
    high: np.ndarray
    plane_z: float
    noise: float

    @property
    def lowest(self) -> float:
        """Height above the plane, metres, below which a single point may be noise."""
        return max(_LOWEST, 4 * self.noise)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(...) bool for (..., 3) world points, metres."""
        x, y, z = np.moveaxis(points, -1, 0)  # axis by axis: several times faster than all at once
        (x0, y0, z0), (x1, y1, z1) = self.low.tolist(), self.high.tolist()
        return ((x >= x0) & (x <= x1) & (y >= y0) & (y <= y1) & (z >= z0) & (z <= z1))

    def union(self, other: Region) -> Region:
        """The smallest region around both, with the support plane of this one."""
        return replace(self, low=np.minimum(self.low, other.low),
                       high=np.maximum(self.high, other.high))


def find_region(views: list[View], config: ReconstructorConfig) -> Region:
    """Finds the support plane and the largest thing that stands on it.

    The plane is the horizontal one with the most area in sight (z is up in the world); the blob
    is the connected footprint with the most points above it.

    Args:
        views: first views of the scan, with depth.
        config: a configured region (`roi_size_m`) is used as given; the plane is found in it.

    Raises:
        ScanError: no plane, or nothing in sight.
    """
    points = np.concatenate([p[np.isfinite(p[:, 2])] for p in
                             (geometry.world_points(v, _STRIDE).reshape(-1, 3) for v in views)])
    given = np.any(config.roi_size_m)
    center, size = np.array(config.roi_center_m), np.array(config.roi_size_m)
    if given:
        points = points[np.all(np.abs(points - center) <= size / 2, axis=1)]
    if len(points) < 100:
        raise ScanError(f"{len(points)} depth points in the region of interest; "
                        "expected 100 or more")
    plane_z, noise = _support_plane(points)
    everything = Region(points.min(axis=0), points.max(axis=0), plane_z, noise)
    if given:
        low = center - size / 2
        low[2] = min(low[2], plane_z - MARGIN)
        return replace(everything, low=low, high=center + size / 2)
    blob = largest_blob(_standing(points, everything))
    if not len(blob):
        return everything
    return _around(blob, everything)


def find_pieces(views: list[View], config: ReconstructorConfig) -> Region:
    """Finds the support plane and all that stands on it: pieces that lie apart.

    Raises:
        ScanError: as `find_region`, or nothing stands there.
    """
    region = find_region(views, config)
    if np.any(config.roi_size_m):
        return region
    points = np.concatenate([p[np.isfinite(p[:, 2])] for p in
                             (geometry.world_points(v, _STRIDE).reshape(-1, 3) for v in views)])
    standing = _standing(points, region)
    of_point, counts = _blobs(standing)
    if len(standing):  # what is much smaller than the largest is noise of far ground
        standing = standing[(counts > _PIECE * counts.max())[of_point]]
    if not len(standing):
        raise ScanError("nothing stands on the support plane; expected pieces that lie apart")
    return _around(standing, region)


def _standing(points: np.ndarray, region: Region) -> np.ndarray:
    """Those of (n, 3) points that stand on the plane: alone by far, or with their neighbours."""
    above = points[:, 2] - region.plane_z
    if not len(points):
        return points
    cells = np.floor(points[:, :2] / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    cell = cells[:, 0] * (cells[:, 1].max() + 1) + cells[:, 1]
    count = np.bincount(cell)
    mean = np.bincount(cell, above) / np.maximum(count, 1)
    ground = (np.abs(mean) < region.lowest) & (count > 0)
    noise = 1.4826 * np.median(np.abs(mean[ground])) if ground.any() else region.noise
    high = (mean > max(_LOWEST / 2, 5 * noise)) & (count >= _FEWEST)
    return points[(above > region.lowest) | (high[cell] & (above > 0))]


def _around(blob: np.ndarray, region: Region) -> Region:
    """What holds these points, the support plane below them, and a margin."""
    low = np.append(blob[:, :2].min(axis=0), region.plane_z)
    return replace(region, low=low - MARGIN, high=blob.max(axis=0) + MARGIN)


def grow(region: Region, view: View) -> Region:
    """The region with what this view shows standing across its border taken in."""
    points = geometry.world_points(view, _STRIDE).reshape(-1, 3)
    around = replace(region, low=region.low - _GROWTH, high=region.high + _GROWTH)
    blob = largest_blob(_standing(points[around.contains(points)], region))
    if not len(blob) or not region.contains(blob).any():
        return region
    return region.union(_around(blob, region))


def crop_to_region(view: View, region: Region) -> View:
    """The pixels that can show something of the region.

    Raises:
        ViewError: reason `out_of_sight`, if there are none.
    """
    corners = np.array(np.meshgrid(*zip(region.low, region.high))).reshape(3, 8).T
    local = geometry.apply(geometry.inverse(view.T_world_camera), corners)
    if np.any(local[:, 2] < 0.01):  # the camera is inside or beside it: the whole image may
        return view
    pixels, _ = geometry.project(local, view.intrinsics)
    return geometry.crop(view, pixels.min(axis=0), pixels.max(axis=0))


def _support_plane(points: np.ndarray) -> tuple[float, float]:
    """Height of the horizontal plane with the most area, and the noise of points around it."""
    # Points thin out with distance squared: one vote for each cell and height levels that out.
    voxels = np.unique(np.floor(points / [_CELL, _CELL, 0.002]).astype(np.int64), axis=0)
    level, votes = np.unique(voxels[:, 2], return_counts=True)
    padded = np.zeros(level[-1] - level[0] + 3)
    padded[level - level[0] + 1] = votes
    smooth = np.convolve(padded, np.ones(3), mode="same")
    mode = (np.argmax(smooth) - 1 + level[0] + 0.5) * 0.002
    near = points[np.abs(points[:, 2] - mode) < 0.015, 2]
    height = float(np.median(near))
    return height, float(1.4826 * np.median(np.abs(near - height)))


def largest_blob(points: np.ndarray) -> np.ndarray:
    """The points of the connected footprint that holds the most of them."""
    if not len(points):
        return points
    of_point, counts = _blobs(points)
    return points[of_point == np.argmax(counts)]


def _blobs(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(n,) which connected footprint each of (n, 3) points is in, from 1 on, and how many points
    each holds; none holds those of number 0."""
    if not len(points):
        return np.zeros(0, np.int64), np.zeros(1, np.int64)
    cells = np.floor(points[:, :2] / _CELL).astype(np.int64)
    cells -= cells.min(axis=0)
    counts = np.zeros(cells.max(axis=0) + 1, np.int64)
    np.add.at(counts, (cells[:, 0], cells[:, 1]), 1)
    # Joins the rim and the parts over the unseen strip between them, and parts beside a heap.
    filled = ndimage.binary_dilation(counts > 0, iterations=_JOINED)
    names, _ = ndimage.label(filled, structure=np.ones((3, 3)))
    of_point = names[cells[:, 0], cells[:, 1]]
    return of_point, np.bincount(of_point)
