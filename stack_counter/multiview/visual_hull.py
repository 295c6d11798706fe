# SPDX-License-Identifier: Apache-2.0
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

# Centres of the eight children of a voxel, in sides of it.
_CHILDREN = np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)], float) / 4
# Largest distance to an outline, pixels, that float16 holds.
_MAX_DISTANCE_PX = 2.0**15


@dataclass(frozen=True)
class VisualHullSettings:
    """How space is divided; all chosen.

    Attributes:
        first_grid: number of voxels along each side of the first grid.
        room: side of the first grid over the largest width of the outlines at its middle.
        max_voxels: largest number of voxels; more would not fit into memory.
    """

    first_grid: int = 48
    room: float = 1.5
    max_voxels: int = 20_000_000


SETTINGS = VisualHullSettings()


@dataclass(frozen=True, eq=False)
class VisualHull:
    """Space that no view proves empty.

    Attributes:
        volume: m3.
        middle: (3,) float64 centre of mass, metres, world.
        surface: (n, 3) float64 centres of the voxels that the outlines cut, metres, world.
        voxel_size: their side, metres.
    """

    volume: float
    middle: np.ndarray
    surface: np.ndarray
    voxel_size: float


@dataclass(frozen=True, eq=False)
class _Outline:
    """What one view shows of the border between background and the rest.

    Attributes:
        view: the view.
        distance: (h, w) float16 distance of every pixel to the border, pixels, above 0 on the
            background.
        known: (h, w) bool pixels that have a label.
    """

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
        min_share: share of the views that must have a voxel in their image for it to be kept.
        votes: number of views that must see a voxel outside their outline to carve it.

    Raises:
        ScanError: the views share no space, there would be too many voxels, or nothing is left
            after carving.
        ViewError: reason `no_labels`, if a view has none.
    """
    # Start with a coarse grid around what all outlines can hold.
    center, size = _common_space(views)
    outlines = [_find_outline(view) for view in views]
    cells = SETTINGS.first_grid
    side = size / cells
    axis = (np.arange(cells) - (cells - 1) / 2) * side
    voxels = np.stack(np.meshgrid(axis, axis, axis, indexing="ij"), -1).reshape(-1, 3) + center
    # Carve; count the voxels wholly inside, and divide those that an outline cuts.
    volume, moment = 0.0, np.zeros(3)
    while True:
        last = side <= voxel_size
        kept, full = _classify_voxels(voxels, outlines, side * np.sqrt(3) / 2, min_share, votes,
                                      last)
        counted = kept if last else full
        volume += np.count_nonzero(counted) * side**3
        moment += voxels[counted].sum(axis=0) * side**3
        cut = voxels[kept & ~full]
        if last or not len(cut):
            break
        if 8 * len(cut) > SETTINGS.max_voxels:
            raise ScanError(f"{8 * len(cut)} voxels of {side / 2:.4f} m on the surface; expected "
                            f"at most {SETTINGS.max_voxels}: choose a larger voxel_size")
        voxels = (cut[:, None] + _CHILDREN * side).reshape(-1, 3)  # (n, 8, 3)
        side /= 2
    if volume == 0:
        raise ScanError(f"0 voxels left after carving with {len(views)} label images; expected "
                        "some: poses and labels disagree, or all labels are background")
    return VisualHull(volume, moment / volume, cut, side)


def _find_outline(view: View) -> _Outline:
    """Returns the outline of a view's labels."""
    labels = require_labels(view)
    # What is not known counts as kept, so that it carves nothing next to it.
    empty = (labels == BACKGROUND).astype(np.uint8)
    distance = cv2.distanceTransform(empty, cv2.DIST_L2, 5) \
        - cv2.distanceTransform(1 - empty, cv2.DIST_L2, 5)
    distance = np.clip(distance, -_MAX_DISTANCE_PX, _MAX_DISTANCE_PX).astype(np.float16)
    return _Outline(view, distance, labels != UNSEEN)


def _common_space(views: list[View]) -> tuple[np.ndarray, float]:
    """Returns centre (3,), world, and side, metres, of a cube around what all outlines can hold.

    Raises:
        ScanError: all is background, or the views look along one direction.
    """
    # Take the ray through the middle of every outline, and its width at distance 1.
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
    # The centre is the point nearest to all rays.
    if not rays:
        raise ScanError(f"all {len(views)} label images are background; expected parts (2) or "
                        "container (1)")
    center = geometry.nearest_point_to_rays(*(np.array(x) for x in zip(*rays)))
    sizes = [s * np.linalg.norm(o - center) for s, (o, _) in zip(spreads, rays)]
    return center, SETTINGS.room * float(np.max(sizes))


def _classify_voxels(voxels: np.ndarray, outlines: list[_Outline], radius: float,
                     min_share: float, votes: int, last: bool
                     ) -> tuple[np.ndarray, np.ndarray]:
    """Returns which voxels are kept, and which of them lie wholly inside all outlines.

    A voxel is carved by `votes` views that see all of it (in the last round: its centre) outside
    the outline, or if too few views see it.

    Args:
        voxels: (n, 3) centres, metres, world.
        outlines: of all views.
        radius: of the ball around a voxel, metres.
        min_share: share of the views that must see a voxel for it to be kept.
        votes: number of views that carve a voxel.
        last: whether the voxels will not be divided again.

    Returns:
        Two (n,) bool arrays.
    """
    against = np.zeros(len(voxels), np.int32)
    kept = np.ones(len(voxels), bool)
    full = np.ones(len(voxels), bool)
    views_seeing = np.zeros(len(voxels), np.int32)
    for outline in outlines:
        # Project the voxels that are left.
        alive = np.nonzero(kept)[0]
        pixels = geometry.project_into(outline.view, voxels[alive])
        known = outline.known[pixels.rows, pixels.cols]
        alive = alive[pixels.inside][known]
        views_seeing[alive] += 1
        # Compare their distance to the outline with their radius in the image.
        distance = outline.distance[pixels.rows[known], pixels.cols[known]].astype(np.float32)
        reach = (radius * outline.view.intrinsics.fx / pixels.depth[known]).astype(np.float32)
        against[alive[distance > (0 if last else reach)]] += 1
        kept = against < votes
        full[alive[distance > -reach]] = False
    kept &= views_seeing >= min_share * len(outlines)
    return kept, kept & full
