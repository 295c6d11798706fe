"""Whether a scan can be right at all: views that agree, one container, and not cut off."""

from __future__ import annotations

import numpy as np

from stack_counter import geometry
from stack_counter.container.rim import Rim, find_rim
from stack_counter.errors import ScanError
from stack_counter.fusion.region import Region, largest_blob
from stack_counter.types import HeightMap, View

_STRIDE = 8  # pixels between the points that are compared
_PAIRS = 12  # of views next to each other, at most
_SEEN_THROUGH = 0.02  # how far behind another view's point one must see to contradict it, m
_CONTRADICTED = 0.25  # share of the points for which the views contradict each other
_FEWEST = 50  # points that two views share
_BORDER_PX = 3
_COARSE = 4  # pixels between the points in which a second container is looked for
_CELL = 0.004  # side of a cell of the map for that, m
_SURE_RIM = 0.85  # share of its outline on which its rim must be seen
_CUT = 0.02  # share of the image's border that shows something standing


def check_agreement(views: list[View], noise: float) -> None:
    """Refuses a scan whose views see through each other's surfaces.

    Args:
        views: with depth.
        noise: of a depth point, metres.

    Raises:
        ScanError: with how far the views are apart.
    """
    first = np.unique(np.linspace(0, len(views) - 1, _PAIRS + 1).astype(int))
    gaps = [_gaps(views[a], views[b]) for a, b in zip(first, first[1:])]
    gaps = [g for g in gaps if len(g) >= _FEWEST]
    if not gaps:
        return
    limit = max(_SEEN_THROUGH, 5 * noise)
    share = float(np.median([np.mean(g > limit) for g in gaps]))
    if share > _CONTRADICTED:
        apart = float(np.median(np.abs(np.concatenate(gaps))))
        raise ScanError(f"the views disagree by {1000 * apart:.0f} mm, {share:.0%} of what one "
                        f"sees is free space to the next; expected below {_CONTRADICTED:.0%}: "
                        "poses of another frame or another time than the images")


def _gaps(one: View, other: View) -> np.ndarray:
    """(n,) metres that the other view sees behind the points of one, where both have depth."""
    assert other.depth is not None  # for the type checker
    points = geometry.world_points(one, _STRIDE).reshape(-1, 3)
    points = points[np.isfinite(points[:, 2])].astype(float)
    pixels = geometry.project_into(other, points)
    measured = other.depth[pixels.rows, pixels.cols]
    return (measured - pixels.depth)[measured > 0]


def stack_leaves_every_image(views: list[View], region: Region) -> bool:
    """Whether every view has something that stands on the plane at the border of its image."""
    return all(_cut(view, region) for view in views)


def _cut(view: View, region: Region) -> bool:
    points = geometry.world_points(view)
    standing = region.contains(points) & (points[..., 2] > region.plane_z + region.lowest)
    b = _BORDER_PX
    border = [standing[:b], standing[-b:], standing[:, :b], standing[:, -b:]]
    return bool(np.concatenate([x.ravel() for x in border]).mean() > _CUT)


def second_container(views: list[View], region: Region) -> str | None:
    """Where else a container stands, in words, if the region holds one and is not the only one.

    Args:
        views: whole images with depth, of the first views.
        region: found around the largest thing in sight.
    """
    points = np.concatenate([p[np.isfinite(p[:, 2])] for p in
                             (geometry.world_points(v, _COARSE).reshape(-1, 3) for v in views)])
    points = points[points[:, 2] > region.plane_z + region.lowest]
    inside = region.contains(points)
    blobs = [points[inside], largest_blob(points[~inside])]
    rims = [_coarse_rim(blob, region) for blob in blobs]
    if any(rim is None for rim in rims):
        return None
    return " and ".join(f"one at x {rim.outline.center[0]:.2f}, y {rim.outline.center[1]:.2f} m"
                        for rim in rims if rim is not None)


def _coarse_rim(points: np.ndarray, region: Region) -> Rim | None:
    """The rim that a few views' points show; None if they show none."""
    if len(points) < _FEWEST:
        return None
    low = points[:, :2].min(axis=0) - 2 * _CELL
    cells = ((points[:, :2] - low) / _CELL).astype(int)
    heights = np.full(cells.max(axis=0)[::-1] + 3, -np.inf, np.float32)
    np.maximum.at(heights, (cells[:, 1], cells[:, 0]), points[:, 2] - region.plane_z)
    heights[np.isinf(heights)] = np.nan
    T_world_map = geometry.pose(np.eye(3), np.append(low, region.plane_z))
    rim = find_rim(HeightMap(T_world_map, _CELL, heights), region.lowest, "auto")
    sure = rim is not None and rim.outline_share >= _SURE_RIM \
        and rim.outline.kind in ("box", "round")
    return rim if sure else None
