"""What a closed container holds, from the outline of its labels and the depth of its surface.

Source: paper, section 3.3: what labels and depth prove empty is taken away; the mean of truncated
distances along rays is that of Curless and Levoy (1996), kept only inside the outlines.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview.visual_hull import VisualHull
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, HeightMap, View

_MAX_VOXELS = 3_000_000
_TRUNC = 3.0  # voxels in front of and behind a measured surface that it decides on
_MIN_SEEN = 2  # views that must have measured a surface for it to carve


@dataclass(frozen=True)
class Carved:
    """Space that neither labels nor depth prove empty.

    Attributes:
        volume, volume_std: above the support plane, m3.
        outline_volume: what the labels alone leave above the support plane, m3.
        surface: (n, 3) float64 centres of the outermost voxels, metres, world.
        top: highest of that space above the support plane.
        measured: share of the surface, the support apart, near which depth was measured, 0 to 1.
    """

    volume: float
    volume_std: float
    outline_volume: float
    surface: np.ndarray
    top: HeightMap
    measured: float


def carve_closed_container(
    views: list[View], hull: VisualHull, voxel_size: float, plane_z: float
) -> Carved:
    """Takes away what is background, below the support, or in front of a measured surface.

    Where no depth was measured, the outline stands.

    Args:
        views: pinhole views with labels and depth, 0 where unknown; z of the world is up.
        hull: of the same labels.
        voxel_size: smallest side of a voxel, metres; larger for a stack beyond 3 million voxels.
        plane_z: height of the support plane, metres, world.

    Raises:
        ScanError: nothing is left.
        ViewError: reasons `no_depth`, `no_labels`.
    """
    voxels, side, shape = _grid(hull, voxel_size, plane_z)
    inside = np.arange(len(voxels))
    for view in views:
        pixels = geometry.project_into(view, voxels[inside])
        kept = np.ones(len(inside), bool)
        kept[pixels.inside] = require_labels(view)[pixels.rows, pixels.cols] != BACKGROUND
        inside = inside[kept]
    distance, count = _distances(views, voxels[inside], _TRUNC * side)
    stands, measured = np.zeros((2, len(voxels)), bool)
    measured[inside] = count >= _MIN_SEEN
    stands[inside] = (distance <= 0) | (count < _MIN_SEEN)
    if not stands.any():
        raise ScanError(f"0 of {len(inside)} voxels left after carving with depth; expected some")
    skin = _skin(stands.reshape(shape)).ravel()
    # A surface is known to a quarter of a voxel where depth decides, else to a voxel at best.
    std = side**3 * (0.25 * np.count_nonzero(skin & measured)
                     + np.count_nonzero(skin & ~measured))
    return Carved(float(stands.sum() * side**3), float(std), len(inside) * side**3,
                  voxels[skin], _top(stands.reshape(shape), voxels[0] - side / 2, side, plane_z),
                  float(measured[skin].mean()))


def _grid(hull: VisualHull, voxel_size: float, plane_z: float
          ) -> tuple[np.ndarray, float, tuple[int, int, int]]:
    """Centres (n, 3) of voxels around the hull above the support, their side, metres, and the
    grid's shape."""
    if not len(hull.surface):
        raise ScanError("the hull's surface has 0 voxels; expected some: carve with larger ones")
    low = hull.surface.min(axis=0) - voxel_size
    high = hull.surface.max(axis=0) + voxel_size
    low[2] = plane_z
    if high[2] <= plane_z:
        raise ScanError(f"the hull ends {plane_z - high[2]:.3f} m below the support; expected "
                        "above it")
    size = high - low
    side = max(voxel_size, float(np.prod(size) / _MAX_VOXELS) ** (1 / 3))
    x, y, z = (int(n) for n in np.ceil(size / side))
    cells = np.stack(np.meshgrid(np.arange(x), np.arange(y), np.arange(z), indexing="ij"), -1)
    return low + (cells.reshape(-1, 3) + 0.5) * side, side, (x, y, z)


def _skin(solid: np.ndarray) -> np.ndarray:
    """(x, y, z) bool, the voxels next to an empty one; below the grid is the support."""
    padded = np.pad(solid, 1)
    padded[1:-1, 1:-1, 0] = solid[:, :, 0]
    return solid & ~ndimage.binary_erosion(padded)[1:-1, 1:-1, 1:-1]


def _top(solid: np.ndarray, low: np.ndarray, side: float, plane_z: float) -> HeightMap:
    """Height of the highest voxel of every column; `low` (3,) is the grid's corner, metres."""
    levels = solid.shape[2] - np.argmax(solid[:, :, ::-1], axis=2)
    heights = np.where(solid.any(axis=2), levels * side, np.nan).T  # (x, y) -> (rows, cols)
    return HeightMap(geometry.pose(np.eye(3), np.array([low[0], low[1], plane_z])), side,
                     heights.astype(np.float32))


def _distances(views: list[View], voxels: np.ndarray, trunc: float
               ) -> tuple[np.ndarray, np.ndarray]:
    """Mean truncated distance (n,) in front of the measured surfaces, metres, and by how many
    views: those that measured one behind the voxel or at most `trunc` before it."""
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
