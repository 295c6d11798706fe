"""Carving without depth: what is left of space when every view's background is taken away.

Source: paper, section 3.3. A view carves only what it sees: space outside its image stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.segmentation.given import label_image
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, UNSEEN, View

_COARSE = 48  # voxels along the side of the first grid
_MAX_VOXELS = 20_000_000
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / 4


@dataclass(frozen=True)
class Hull:
    """Voxels that no view proves empty: centres (n, 3) float64, metres, world; their side in
    metres; surface (n,) bool, those with a neighbour that was carved."""

    centers: np.ndarray
    voxel_size: float
    surface: np.ndarray

    @property
    def volume(self) -> float:
        """m3."""
        return len(self.centers) * self.voxel_size**3


def carve(views: list[View], voxel_size: float, min_share: float) -> Hull:
    """Carves from coarse to fine.

    Args:
        views: pinhole views with labels; anything but background is kept.
        voxel_size: largest side of the final voxels, metres.
        min_share: share of the views that must have a voxel in their image for it to stand.

    Raises:
        ScanError: the views share no space, or nothing is left after carving.
    """
    center, size = _common_space(views)
    side = size / _COARSE
    axis = (np.arange(_COARSE) - (_COARSE - 1) / 2) * side
    voxels = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + center
    # While voxels are coarse, one is carved only if all of it lies outside the outline.
    voxels = voxels[_standing(voxels, views, side * np.sqrt(3) / 2, min_share)]
    while side > voxel_size and len(voxels):
        if 8 * len(voxels) > _MAX_VOXELS:
            raise ScanError(f"{8 * len(voxels)} voxels of {side / 2:.4f} m after carving; "
                            f"expected at most {_MAX_VOXELS}: choose a larger voxel_size")
        voxels = (voxels[:, None] + _CORNERS * side).reshape(-1, 3)  # (n, 8, 3)
        side /= 2
        radius = side * np.sqrt(3) / 2 if side > voxel_size else 0.0
        voxels = voxels[_standing(voxels, views, radius, min_share)]
    if not len(voxels):
        raise ScanError(f"0 voxels left after carving with {len(views)} label images; expected "
                        "some: poses and labels disagree, or all labels are background")
    return Hull(voxels, side, _on_surface(voxels, side))


def _common_space(views: list[View]) -> tuple[np.ndarray, float]:
    """Centre and side, metres, of a cube around what all outlines can hold."""
    rays, spreads = [], []
    for view in views:
        rows, cols = np.nonzero(np.isin(label_image(view), (CONTAINER, PARTS)))
        if not len(rows):
            continue
        k = view.intrinsics
        middle = np.array([(cols.min() + cols.max()) / 2, (rows.min() + rows.max()) / 2])
        ray = np.array([(middle[0] - k.cx) / k.fx, (middle[1] - k.cy) / k.fy, 1.0])
        rays.append((view.T_world_camera[:3, 3], view.T_world_camera[:3, :3] @ ray
                     / np.linalg.norm(ray)))
        spreads.append(max(np.ptp(cols) / k.fx, np.ptp(rows) / k.fy))
    if not rays:
        raise ScanError(f"all {len(views)} label images are background; expected parts (2) or "
                        "container (1)")
    # The point closest to all rays, in least squares.
    across = [np.eye(3) - np.outer(d, d) for _, d in rays]
    normal = np.sum(across, axis=0)
    if np.linalg.cond(normal) > 1e6:
        raise ScanError("the views look along one direction; expected views from several sides")
    center = np.linalg.solve(normal, np.sum([a @ o for a, (o, _) in zip(across, rays)], axis=0))
    sizes = [s * np.linalg.norm(o - center) for s, (o, _) in zip(spreads, rays)]
    return center, 1.5 * float(np.max(sizes))


def _standing(voxels: np.ndarray, views: list[View], radius: float, min_share: float
              ) -> np.ndarray:
    """(n,) bool: seen by enough views and by none as background farther than `radius` metres."""
    stands = np.ones(len(voxels), bool)
    seen_by = np.zeros(len(voxels), np.int32)
    for view in views:
        labels = label_image(view)
        alive = np.nonzero(stands)[0]
        pixels, z = geometry.project(
            geometry.apply(geometry.inverse(view.T_world_camera), voxels[alive]), view.intrinsics)
        with np.errstate(invalid="ignore"):
            cells = np.where(np.abs(pixels) < 1e6, np.round(pixels), -1).astype(int)
        inside = (z > 0) & np.all((cells >= 0) & (cells < labels.shape[::-1]), axis=1)
        alive, cells, z = alive[inside], cells[inside], z[inside]
        known = labels[cells[:, 1], cells[:, 0]] != UNSEEN
        alive, cells, z = alive[known], cells[known], z[known]
        seen_by[alive] += 1
        # Distance to the outline in pixels; UNSEEN counts as kept, so it carves nothing near it.
        outside = cv2.distanceTransform((labels == BACKGROUND).astype(np.uint8),
                                        cv2.DIST_L2, 5)
        reach = radius * view.intrinsics.fx / z
        stands[alive[outside[cells[:, 1], cells[:, 0]] > reach]] = False
    return stands & (seen_by >= min_share * len(views))


def _on_surface(voxels: np.ndarray, side: float) -> np.ndarray:
    """(n,) bool: voxels with at least one of six neighbours missing."""
    cells = np.round((voxels - voxels.min(axis=0)) / side).astype(int) + 1
    grid = np.zeros(cells.max(axis=0) + 2, bool)
    grid[tuple(cells.T)] = True
    buried = np.ones(len(voxels), bool)
    for axis in range(3):
        for step in (-1, 1):
            buried &= np.roll(grid, step, axis)[tuple(cells.T)]
    return ~buried
