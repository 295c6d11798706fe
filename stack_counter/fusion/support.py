# SPDX-License-Identifier: Apache-2.0
"""The support plane: the horizontal plane that containers and heaps stand on."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

_MAD_TO_STD = 1.4826


@dataclass(frozen=True)
class SupportSettings:
    """How the support plane is found, and told from the level tops of parts; all are chosen.

    Attributes:
        cell: side of a cell of the maps, m.
        plane_bin: step of the histogram of heights in which the plane is found, m.
        plane_reach: distance from that histogram's peak of points that measure the plane, m.
        unknown_noise: noise of depth points where no plane shows it, m.
        min_points: least number of points that show the noise.
        around: horizontal distance from a configured region within which its plane is looked for,
            m.
        below_region: distance below a configured region at which its plane may lie, m.
        min_peak_share: least area of a plane, over that of the largest one.
        standing: height above a plane of what surely stands on it, m.
        join_cells: gaps, cells, over which a wall, or a plane, goes on.
        min_open_area: least area of the plane in sight that nothing encloses, m2.
        lower: depth below a plane of what surely lies below it, m.
        noise_factor: both of these heights in standard deviations of a point around its cell's
            mean at least.
        noise_cell_points: points of the cell that holds the median point, for the noise in cells.
        max_lower_share: largest share of a plane in which something lower shows through it.
    """

    cell: float = 0.005
    plane_bin: float = 0.002
    plane_reach: float = 0.015
    unknown_noise: float = 0.001
    min_points: int = 100
    around: float = 0.25
    below_region: float = 0.03
    min_peak_share: float = 0.2
    standing: float = 0.01
    join_cells: int = 3
    min_open_area: float = 0.0015
    lower: float = 0.008
    noise_factor: float = 4.0
    noise_cell_points: int = 8
    max_lower_share: float = 0.05


SETTINGS = SupportSettings()


@dataclass(frozen=True)
class SupportPlane:
    """A horizontal plane.

    Attributes:
        height: world z, metres.
        noise: standard deviation of single depth points around it, metres.
        is_certain: given, or in sight; False for what may be level parts or a container's floor.
    """

    height: float
    noise: float
    is_certain: bool


def find_support_plane(points: np.ndarray, given_height: float = np.nan,
                       low: np.ndarray | None = None, high: np.ndarray | None = None
                       ) -> SupportPlane:
    """Finds the support plane in all that is seen.

    Without a region it is the horizontal plane with the most area. With one it is the lowest of
    the large planes around the region that lie in its range of heights, else the highest below
    it: the level tops of parts in the region are no support.

    Args:
        points: (n, 3) world points of all views, metres; n > 0.
        given_height: world z of the plane where it is known, metres; else NaN.
        low: (3,) corner of a configured region, world, metres; or None.
        high: (3,) its other corner.
    """
    s = SETTINGS
    if np.isfinite(given_height):
        near = points[np.abs(points[:, 2] - given_height) < s.plane_reach, 2]
        noise = _robust_std(near - np.median(near)) if len(near) >= s.min_points \
            else s.unknown_noise
        return SupportPlane(float(given_height), noise, True)
    if low is not None and high is not None:
        beyond = np.maximum(low[:2] - points[:, :2], points[:, :2] - high[:2]).max(axis=1)
        points = points[(beyond < s.around) & (points[:, 2] < high[2])]
        mode = _plane_of_region(points, low[2] - s.below_region)
    else:
        heights, votes = _plane_votes(points)
        mode = heights[np.argmax(votes)]
    # Median and robust standard deviation of the points around it.
    near = points[np.abs(points[:, 2] - mode) < s.plane_reach, 2]
    height = float(np.median(near))
    noise = _robust_std(near - height)
    return SupportPlane(height, noise, _is_support(points, height))


def _plane_votes(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(k,) heights, metres, and the (k,) area, cells, that lies level with each of them."""
    s = SETTINGS
    # Points thin out with distance squared: one vote for each cell and height levels that out.
    voxels = np.unique(np.floor(points / [s.cell, s.cell, s.plane_bin]).astype(np.int64), axis=0)
    level, votes = np.unique(voxels[:, 2], return_counts=True)
    padded = np.zeros(level[-1] - level[0] + 3)
    padded[level - level[0] + 1] = votes
    smooth = np.convolve(padded, np.ones(3), mode="same")
    return (np.arange(len(smooth)) - 1 + level[0] + 0.5) * s.plane_bin, smooth


def _plane_of_region(points: np.ndarray, lowest: float) -> float:
    """Height of the plane that a region's content stands on, metres.

    Args:
        points: (n, 3) world points in and around the region, metres.
        lowest: least height at which the plane lies in the region's range.
    """
    heights, votes = _plane_votes(points)
    is_peak = (votes >= np.roll(votes, 1)) & (votes >= np.roll(votes, -1))
    peaks = heights[is_peak & (votes >= SETTINGS.min_peak_share * votes.max())]
    in_range = peaks[peaks >= lowest]
    return float(in_range.min() if len(in_range) else peaks.max())


def _is_support(points: np.ndarray, height: float) -> bool:
    """Whether a plane is what things stand on, not the level tops of parts or a bin's floor.

    A support shows outside of what stands on it, and nothing shows through it.

    Args:
        points: (n, 3) world points, metres.
        height: of the plane, world z, metres.
    """
    s = SETTINGS
    noise = _noise_within_cells(points[np.abs(points[:, 2] - height) < s.plane_reach])
    lower_by = max(s.lower, s.noise_factor * noise)
    # Map what stands on the plane, what is level with it, and what lies below it.
    cells = np.floor(points[:, :2] / s.cell).astype(np.int64)
    cells -= cells.min(axis=0) - s.join_cells
    above = points[:, 2] - height
    shape = tuple(cells.max(axis=0) + 1 + s.join_cells)

    def has(chosen: np.ndarray) -> np.ndarray:
        found = np.zeros(shape, bool)
        found[cells[chosen, 0], cells[chosen, 1]] = True
        return found
    standing = has(above > max(s.standing, s.noise_factor * noise))
    level = has(np.abs(above) < lower_by) & ~standing
    lower = has(above < -lower_by) & ~level & ~standing
    # What lies below must not show through the plane.
    through = lower & ndimage.binary_closing(level, iterations=s.join_cells)
    if np.count_nonzero(through) > s.max_lower_share * np.count_nonzero(level):
        return False
    # Enough of the plane lies outside of all walls.
    enclosed = ndimage.binary_fill_holes(ndimage.binary_closing(standing,
                                                                iterations=s.join_cells))
    return bool(np.count_nonzero(level & ~enclosed) * s.cell**2 >= s.min_open_area)


def _noise_within_cells(points: np.ndarray) -> float:
    """Standard deviation of (n, 3) points' heights around the mean of their cell, metres.

    Waves that are wider than a cell, as of round parts, are no noise. Cells are as small as they
    can be to hold some points each.
    """
    side, places = SETTINGS.cell, points[:, :2] - points[:, :2].min(axis=0)
    while True:
        xy = np.floor(places / side).astype(np.int64)
        _, cell = np.unique(xy[:, 0] * (np.ptp(xy[:, 1]) + 1) + xy[:, 1], return_inverse=True)
        count = np.bincount(cell)
        if np.median(count[cell]) >= SETTINGS.noise_cell_points or len(count) == 1:
            break
        side *= 2
    mean = np.bincount(cell, points[:, 2]) / count
    return _robust_std(points[:, 2] - mean[cell])


def _robust_std(residuals: np.ndarray) -> float:
    """Standard deviation by the median of absolute residuals."""
    return float(_MAD_TO_STD * np.median(np.abs(residuals)))
