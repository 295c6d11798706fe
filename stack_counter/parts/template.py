# SPDX-License-Identifier: Apache-2.0
"""v from a scan of pieces that lie apart on a table (paper, section 3.3, "Unit volume").

What lies below a piece is not seen from above: its height map holds more than the piece. Views
from aside carve some of that away, and a piece in another rest pose hides other places. How much
is left over is predicted by `template_model`.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy import ndimage
from scipy.spatial import ConvexHull, QhullError

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError, ViewError
from stack_counter.fusion.region import find_pieces
from stack_counter.parts.template_model import Template
from stack_counter.reconstruction import DepthReconstruction
from stack_counter.types import StackVolume, View


@dataclass(frozen=True)
class TemplateSettings:
    """Tunables of the scan of pieces; the regression was fitted with them. All are chosen.

    Attributes:
        voxel_size: of fusion and carving, m.
        min_views: with depth, of one scan.
        speck_share: area over that of the largest piece, below which a fragment is no piece.
        max_gap: cells of the map within which fragments may belong to one piece.
        free_margin: m that a surface must lie behind a place to prove it empty.
        empty_views: views that must prove a place empty.
        min_carved_share: of the volume below a piece's top, which carving leaves at least.
        max_ratio: of the largest and the smallest piece, above which they are not whole or not
            of one part.
    """

    voxel_size: float = 0.001
    min_views: int = 6
    speck_share: float = 0.02
    max_gap: int = 7
    free_margin: float = 0.0015
    empty_views: int = 2
    min_carved_share: float = 0.05
    max_ratio: float = 5.0


SETTINGS = TemplateSettings()


def scan_template(views: list[View], pieces: int, config: ReconstructorConfig) -> Template:
    """Reconstructs pieces that lie apart and measures each.

    Args:
        views: of one scan; those without depth are left out.
        pieces: number of pieces.
        config: settings; container and voxel size are not used.

    Raises:
        ScanError: too few views with depth, no region or surface, another number of pieces, or
            pieces too unlike to be whole.
    """
    views = [view for view in views if view.depth is not None]
    if len(views) < SETTINGS.min_views:
        raise ScanError(f"{len(views)} views with depth; expected at least {SETTINGS.min_views}, "
                        "from all sides: what no view sees counts as part of the pieces")
    # Fuse the region around the pieces, without a container.
    region = find_pieces(views, config)
    center, size = (region.low + region.high) / 2, region.high - region.low
    scan = DepthReconstruction(replace(
        config, container="", container_kind="none", voxel_size=SETTINGS.voxel_size, live=False,
        roi_center_m=tuple(map(float, center)), roi_size_m=tuple(map(float, size))))
    for view in views:
        with suppress(ViewError):  # the others go on
            scan.add_view(geometry.rectify(view))
    return measure_template(scan.measure_volume(taught=None), scan.views, pieces)


def measure_template(volume: StackVolume, views: list[View], pieces: int) -> Template:
    """Tells the pieces of a volume without container apart and measures each.

    Args:
        volume: of kind `none`, with depth.
        views: by which it was reconstructed.
        pieces: number of pieces.

    Raises:
        ScanError: another number of pieces, or pieces too unlike to be whole.
    """
    assert volume.top is not None  # scans without depth are refused before
    heights, pitch = volume.top.heights, volume.top.pitch
    labels = _label_pieces(np.isfinite(heights), pieces)
    # Carve each piece by the views, and describe its shape.
    carved, shapes = [], []
    for label in range(1, pieces + 1):
        rows, cols = np.nonzero(labels == label)
        tops = heights[rows, cols]
        xy = (np.stack([cols, rows], axis=1) + 0.5) * pitch
        full = float(tops.sum()) * pitch**2
        voxels = _count_carved_voxels(xy, tops, volume.top.T_world_map, views)
        left = voxels * pitch**2 * SETTINGS.voxel_size
        carved.append(max(left, SETTINGS.min_carved_share * full))
        shapes.append(_shape_features(xy, tops, pitch, full, carved[-1]))
    return _make_template(np.array(carved), np.array(shapes), len(views))


def _make_template(v: np.ndarray, shapes: np.ndarray, views: int) -> Template:
    """Template of (K,) carved volumes, m3, and (K, 7) features of their shapes."""
    if v.max() > SETTINGS.max_ratio * v.min():
        raise ScanError(f"the largest piece seen is {v.max() / v.min():.1f} times the smallest; "
                        "expected whole pieces of one part, less than "
                        f"{SETTINGS.max_ratio:.0f} times apart (parts this thin or small are not "
                        "seen whole: count a bin instead)")
    smallest = int(np.argmin(v))
    features = np.concatenate([
        shapes.mean(axis=0), shapes[smallest],
        [np.log(v.mean() / v.min()), np.log(v).std(), np.log(v.min()) / 3 + 5,
         1 / np.sqrt(len(v)), 1 / views]])
    return Template(v, features)


def _label_pieces(occupied: np.ndarray, pieces: int) -> np.ndarray:
    """Labels 1 to `pieces` of the cells; fragments closer than a few cells belong together.

    Args:
        occupied: (rows, cols) bool, the cells in which something stands.
        pieces: number of pieces.

    Returns:
        (rows, cols) int; 0 where nothing stands, or a fragment too small to be a piece.

    Raises:
        ScanError: there is another number of pieces.
    """
    numbers = []
    for gap in range(SETTINGS.max_gap + 1):
        # Join fragments over the gap, and number them.
        joined = cv2.dilate(occupied.astype(np.uint8), np.ones((2 * gap + 1,) * 2)) > 0
        labels, count = ndimage.label(joined, np.ones((3, 3)))
        labels = np.where(occupied, labels, 0)
        # Leave out what is too small to be a piece.
        areas = np.bincount(labels.ravel(), minlength=count + 1)[1:]
        large = [i + 1 for i, area in enumerate(areas)
                 if area > SETTINGS.speck_share * areas.max()] if count else []
        numbers.append(len(large))
        if len(large) == pieces:
            order = np.zeros(count + 1, int)
            order[large] = np.arange(1, pieces + 1)
            return order[labels]
    raise ScanError(f"{numbers[0]} pieces lie on the table; expected {pieces}, more than "
                    f"{SETTINGS.max_gap} mm apart")


def _count_carved_voxels(xy: np.ndarray, tops: np.ndarray, T_world_map: np.ndarray,
                         views: list[View]) -> float:
    """Number of voxels below a piece's top that too few views look through.

    Args:
        xy: (n, 2) float64, its cells, metres, map frame.
        tops: (n,) float, heights of the cells, metres.
        T_world_map: (4, 4) float64.
        views: with depth.
    """
    # Fill the columns below the top with voxels.
    voxel = SETTINGS.voxel_size
    levels = np.arange(0, float(tops.max()), voxel) + voxel / 2
    below = levels[None] < tops[:, None]
    points = np.concatenate([np.repeat(xy[:, None], len(levels), axis=1),
                             np.broadcast_to(levels[None, :, None], (*below.shape, 1))], axis=2)
    points = geometry.apply(T_world_map, points[below])
    # Count the views that see a surface behind each.
    empty = np.zeros(len(points), int)
    for view in views:
        assert view.depth is not None  # views without depth are left out before
        pixels = geometry.project_into(view, points)
        empty[pixels.inside] += view.depth[pixels.rows, pixels.cols] \
            > pixels.depth + SETTINGS.free_margin
    return float(np.count_nonzero(empty < SETTINGS.empty_views))


def _shape_features(xy: np.ndarray, tops: np.ndarray, pitch: float, full: float, carved: float
                    ) -> np.ndarray:
    """(7,) float64 features of one piece's shape, most of them logs.

    How much was carved away, how full its box and its hull are, how convex its outline, how flat
    and how long it is, how even its top.

    Args:
        xy: (n, 2) float64, its cells, metres, map frame.
        tops: (n,) float, heights of the cells, metres.
        pitch: of the map, metres.
        full: volume below its top, m3.
        carved: volume that carving leaves, m3.
    """
    area, highest = len(xy) * pitch**2, float(np.percentile(tops, 98))
    try:
        outline = ConvexHull(xy)
        solid = ConvexHull(np.concatenate([np.column_stack([xy, tops]),
                                           np.column_stack([xy, np.zeros(len(xy))])]))
        hull_area, hull = float(outline.volume), float(solid.volume)
    except QhullError:  # too few cells, or all in a line
        hull_area, hull = area, full
    spread, _ = np.linalg.eigh(np.cov(xy.T) + np.eye(2) * pitch**2)
    return np.array([np.log(carved / full), np.log(full / (area * highest)),
                     np.log(full / hull), np.log(area / hull_area),
                     np.log(highest / np.sqrt(area)), np.log(spread[1] / spread[0]) / 4,
                     np.log(tops.std() / highest + 0.02) / 2])
