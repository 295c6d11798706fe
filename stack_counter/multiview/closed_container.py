# SPDX-License-Identifier: Apache-2.0
"""What a closed container holds, from the outline of its labels and the depth of its surface.

Source: paper, section 3.3: what labels and depth prove empty is taken away; the mean of truncated
distances along rays is that of Curless and Levoy (1996), kept only inside the outlines.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview.visual_hull import VisualHull
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, HeightMap, View


@dataclass(frozen=True)
class ClosedContainerSettings:
    """How space is carved by labels and depth; all chosen.

    Attributes:
        max_voxels: largest number of voxels; larger stacks get larger voxels.
        trunc_voxels: distance from a measured surface up to which it decides, voxels.
        min_views: least number of views that must have measured a surface for it to carve.
        depth_std_voxels: standard deviation of a surface that depth decides on, voxels.
        outline_std_voxels: the same where labels alone decide.
    """

    max_voxels: int = 3_000_000
    trunc_voxels: float = 3.0
    min_views: int = 2
    depth_std_voxels: float = 0.25
    outline_std_voxels: float = 1.0


SETTINGS = ClosedContainerSettings()


@dataclass(frozen=True, eq=False)
class CarvedStack:
    """Space that neither labels nor depth prove empty.

    Attributes:
        volume, volume_std: above the support plane, m3.
        outline_volume: what the labels alone leave above the support plane, m3.
        surface: (n, 3) float64 centres of the outermost voxels, metres, world.
        top: highest of that space above the support plane.
        measured_share: share of the surface, the support apart, near which depth was measured, 0
            to 1.
    """

    volume: float
    volume_std: float
    outline_volume: float
    surface: np.ndarray
    top: HeightMap
    measured_share: float


def carve_closed_container(
        views: list[View], hull: VisualHull, voxel_size: float, plane_z: float
) -> CarvedStack:
    """Carves what is background, below the support, or in front of a measured surface.

    Where no depth was measured, the outline stands.

    Args:
        views: pinhole views with labels and depth, 0 where unknown; z of the world is up.
        hull: of the same labels.
        voxel_size: smallest side of a voxel, metres; larger for a stack of too many voxels.
        plane_z: height of the support plane, metres, world.

    Raises:
        ScanError: the hull has no surface above the support, or nothing is left.
        ViewError: reason `no_depth` or `no_labels`, if a view lacks them.
    """
    # Keep the voxels that lie inside all outlines.
    voxels, side, shape = _make_grid(hull, voxel_size, plane_z)
    inside = np.arange(len(voxels))
    for view in views:
        pixels = geometry.project_into(view, voxels[inside])
        kept = np.ones(len(inside), bool)
        kept[pixels.inside] = require_labels(view)[pixels.rows, pixels.cols] != BACKGROUND
        inside = inside[kept]
    # Carve what enough views measured to lie in front of the surface.
    distance, count = _mean_distances(views, voxels[inside], SETTINGS.trunc_voxels * side)
    solid, measured = np.zeros((2, len(voxels)), bool)
    measured[inside] = count >= SETTINGS.min_views
    solid[inside] = (distance <= 0) | (count < SETTINGS.min_views)
    if not solid.any():
        raise ScanError(f"0 of {len(inside)} voxels left after carving with depth; expected some")
    # Propagate the error of the surface, which is known better where depth decides.
    skin = _surface_voxels(solid.reshape(shape)).ravel()
    std = side**3 * (SETTINGS.depth_std_voxels * np.count_nonzero(skin & measured)
                     + SETTINGS.outline_std_voxels * np.count_nonzero(skin & ~measured))
    return CarvedStack(
        volume=float(solid.sum() * side**3), volume_std=float(std),
        outline_volume=len(inside) * side**3, surface=voxels[skin],
        top=_top_heights(solid.reshape(shape), voxels[0] - side / 2, side, plane_z),
        measured_share=float(measured[skin].mean()))


class _Grid(NamedTuple):
    """Centres (n, 3) of cubic voxels, metres, world.

    Their side, metres; their number along the axes.
    """

    voxels: np.ndarray
    side: float
    shape: tuple[int, int, int]


def _make_grid(hull: VisualHull, voxel_size: float, plane_z: float) -> _Grid:
    """Returns the voxels around a hull above the support.

    Raises:
        ScanError: the hull has no surface above the support.
    """
    if not len(hull.surface):
        raise ScanError("the hull's surface has 0 voxels; expected some: carve with larger ones")
    low = hull.surface.min(axis=0) - voxel_size
    high = hull.surface.max(axis=0) + voxel_size
    low[2] = plane_z
    if high[2] <= plane_z:
        raise ScanError(f"the hull ends {plane_z - high[2]:.3f} m below the support; expected "
                        "above it")
    # Enlarge the voxels where there would be too many.
    size = high - low
    side = max(voxel_size, float(np.prod(size) / SETTINGS.max_voxels) ** (1 / 3))
    x, y, z = (int(n) for n in np.ceil(size / side))
    cells = np.stack(np.meshgrid(np.arange(x), np.arange(y), np.arange(z), indexing="ij"), -1)
    return _Grid(low + (cells.reshape(-1, 3) + 0.5) * side, side, (x, y, z))


def _surface_voxels(solid: np.ndarray) -> np.ndarray:
    """Returns (x, y, z) bool, the voxels next to an empty one; below the grid is the support."""
    padded = np.pad(solid, 1)
    padded[1:-1, 1:-1, 0] = solid[:, :, 0]
    return solid & ~ndimage.binary_erosion(padded)[1:-1, 1:-1, 1:-1]


def _top_heights(solid: np.ndarray, low: np.ndarray, side: float, plane_z: float) -> HeightMap:
    """Returns the height of the highest voxel of every column above the support plane.

    Args:
        solid: (x, y, z) bool.
        low: (3,) lowest corner of the grid, metres, world.
        side: of a voxel, metres.
        plane_z: height of the support plane, metres, world.
    """
    levels = solid.shape[2] - np.argmax(solid[:, :, ::-1], axis=2)
    heights = np.where(solid.any(axis=2), levels * side, np.nan).T  # (x, y) -> (rows, cols)
    return HeightMap(geometry.pose(np.eye(3), np.array([low[0], low[1], plane_z])), side,
                     heights.astype(np.float32))


def _mean_distances(views: list[View], voxels: np.ndarray, trunc: float
                    ) -> tuple[np.ndarray, np.ndarray]:
    """Averages the truncated distances by which voxels lie in front of the measured surfaces.

    Args:
        views: with depth, metres, 0 where unknown.
        voxels: (n, 3) centres, metres, world.
        trunc: largest distance, metres; farther behind a surface a view says nothing.

    Returns:
        (n,) float64 mean distance, metres, above 0 in front; and (n,) int number of views in it.

    Raises:
        ViewError: reason `no_depth`, if a view has none.
    """
    total, count = np.zeros(len(voxels)), np.zeros(len(voxels), int)
    for view in views:
        if view.depth is None:
            raise ViewError("no_depth", "the view has no depth image; expected one")
        pixels = geometry.project_into(view, voxels)
        depth = view.depth[pixels.rows, pixels.cols]
        free = depth - pixels.depth
        used = (depth > 0) & (free > -trunc)
        index = np.flatnonzero(pixels.inside)[used]
        total[index] += np.clip(free[used], -trunc, trunc)
        count[index] += 1
    return total / np.maximum(count, 1), count
