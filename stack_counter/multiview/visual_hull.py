"""Carving without depth: what is left of space when every view's background is taken away.

Source: paper, section 3.3. A view carves only what it sees: space outside its image stays.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, UNSEEN, View

_COARSE = 48  # voxels along the side of the first grid
_FAR_PX = 2.0**15  # largest distance kept, pixels
_MAX_VOXELS = 20_000_000
_CORNERS = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / 4


@dataclass(frozen=True)
class VisualHull:
    """Space that no view proves empty: its volume in m3, its middle (3,), and the voxels of its
    surface: centres (n, 3) float64, metres, world, and their side in metres."""

    volume: float
    middle: np.ndarray
    surface: np.ndarray
    voxel_size: float


@dataclass(frozen=True)
class _Outline:
    """One view: distance of every pixel to the outline in pixels, above 0 outside of it
    ((h, w) float16), and which pixels are known ((h, w) bool)."""

    view: View
    distance: np.ndarray
    known: np.ndarray


def carve_visual_hull(
    views: list[View], voxel_size: float, min_share: float, votes: int = 1
) -> VisualHull:
    """Carves from coarse to fine; only voxels that the outline cuts are divided.

    Args:
        views: pinhole views with labels; anything but background is kept.
        voxel_size: largest side of the final voxels, metres.
        min_share: share of the views that must have a voxel in their image for it to stand.
        votes: so many views must see a voxel outside their outline to carve it.

    Raises:
        ScanError: the views share no space, or nothing is left after carving.
    """
    center, size = _common_space(views)
    outlines = [_outline(view) for view in views]
    side = size / _COARSE
    axis = (np.arange(_COARSE) - (_COARSE - 1) / 2) * side
    voxels = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + center
    volume, moment = 0.0, np.zeros(3)
    while True:
        last = side <= voxel_size
        stands, full = _standing(voxels, outlines, side * np.sqrt(3) / 2, min_share, votes,
                                 last)
        counted = stands if last else full
        volume += np.count_nonzero(counted) * side**3
        moment += voxels[counted].sum(axis=0) * side**3
        cut = voxels[stands & ~full]
        if last or not len(cut):
            break
        if 8 * len(cut) > _MAX_VOXELS:
            raise ScanError(f"{8 * len(cut)} voxels of {side / 2:.4f} m on the surface; expected "
                            f"at most {_MAX_VOXELS}: choose a larger voxel_size")
        voxels = (cut[:, None] + _CORNERS * side).reshape(-1, 3)  # (n, 8, 3)
        side /= 2
    if volume == 0:
        raise ScanError(f"0 voxels left after carving with {len(views)} label images; expected "
                        "some: poses and labels disagree, or all labels are background")
    return VisualHull(volume, moment / volume, cut, side)


def _outline(view: View) -> _Outline:
    labels = require_labels(view)
    # What is not known counts as kept, so that it carves nothing next to it.
    empty = (labels == BACKGROUND).astype(np.uint8)
    distance = cv2.distanceTransform(empty, cv2.DIST_L2, 5) \
        - cv2.distanceTransform(1 - empty, cv2.DIST_L2, 5)
    return _Outline(view, np.clip(distance, -_FAR_PX, _FAR_PX).astype(np.float16),
                    labels != UNSEEN)


def _common_space(views: list[View]) -> tuple[np.ndarray, float]:
    """Centre and side, metres, of a cube around what all outlines can hold."""
    rays, spreads = [], []
    for view in views:
        rows, cols = np.nonzero(np.isin(require_labels(view), (CONTAINER, PARTS)))
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
    center = geometry.nearest_point_to_rays(*(np.array(x) for x in zip(*rays)))
    sizes = [s * np.linalg.norm(o - center) for s, (o, _) in zip(spreads, rays)]
    return center, 1.5 * float(np.max(sizes))


def _standing(voxels: np.ndarray, outlines: list[_Outline], radius: float, min_share: float,
              votes: int, last: bool) -> tuple[np.ndarray, np.ndarray]:
    """(n,) bool each: not carved, and wholly inside all outlines.

    A voxel is carved by `votes` views that see all of it (in the last round: its centre) outside
    the outline, or if too few views see it. `radius` is that of the ball around it, metres.
    """
    against = np.zeros(len(voxels), np.int32)
    stands = np.ones(len(voxels), bool)
    full = np.ones(len(voxels), bool)
    seen_by = np.zeros(len(voxels), np.int32)
    for outline in outlines:
        alive = np.nonzero(stands)[0]
        pixels = geometry.project_into(outline.view, voxels[alive])
        known = outline.known[pixels.rows, pixels.cols]
        alive = alive[pixels.inside][known]
        seen_by[alive] += 1
        distance = outline.distance[pixels.rows[known], pixels.cols[known]].astype(np.float32)
        reach = (radius * outline.view.intrinsics.fx / pixels.depth[known]).astype(np.float32)
        against[alive[distance > (0 if last else reach)]] += 1
        stands = against < votes
        full[alive[distance > -reach]] = False
    stands &= seen_by >= min_share * len(outlines)
    return stands, stands & full
