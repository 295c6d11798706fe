"""Depth maps from posed pictures alone, bounded by the hull of their labels.

    carved = hull.carve(views, voxel_size, min_share)
    views = depth_from_pictures(views, carved)    # the same views with depth

Source: paper, section 3.3, whose depth comes from posed pictures too; the checks between views
are those of Schoenberger et al., "Pixelwise View Selection for Unstructured Multi-View Stereo"
(2016), reduced to agreement in depth.
"""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError, ViewError
from stack_counter.multiview.plane_sweep import Picture, aggregate, best_planes, sweep
from stack_counter.multiview.visual_hull import VisualHull
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, View

_MAX_PLANES, _MIN_PLANES = 224, 16
_SMALL, _LARGE = 60, 600  # costs of a step and of a jump between neighbouring pixels
_LEVELS = 16  # steps between planes that speckles are told apart by
_BEHIND = 0.5  # how far behind the hull the support is looked for, in depths of the hull


@dataclass(frozen=True)
class StereoConfig:
    """How depth is made from pictures.

    Attributes:
        neighbours: pictures that a view is compared with.
        min_angle, max_angle: between the lines of sight to the stack, rad.
        radius: of the correlation window, pixels.
        edge: width of what is left open beside the edges that labels show, pixels.
        support: width of the ring of background around the stack that gets depth too, as a share
            of the stack's largest side in the picture.
        min_margin: lowest share by which the second best depth must cost more.
        tolerance: relative difference at which depths of two views agree.
        min_agree: other views that must agree.
    """

    neighbours: int = 5
    min_angle: float = float(np.deg2rad(5))
    max_angle: float = float(np.deg2rad(30))
    radius: int = 1
    edge: int = 2
    support: float = 0.1
    min_margin: float = 0.02
    tolerance: float = 0.01
    min_agree: int = 2


def depth_from_pictures(views: list[View], hull: VisualHull, config: StereoConfig = StereoConfig()
                        ) -> list[View]:
    """The views with depth: multi-view stereo on their colour images.

    Args:
        views: pinhole views with colour, labels and known poses.
        hull: space that their labels leave; the surface is looked for in it.

    Returns:
        The views; `depth` is (h, w) float32 metres along optical z, 0 where nothing is known.
        The ring of background has depth where seen.

    Raises:
        ViewError: reasons `no_color`, `no_labels`.
        ScanError: fewer than three views, or an empty surface of the hull.
    """
    if len(views) < 3:
        raise ScanError(f"{len(views)} views; stereo expects at least 3")
    if not len(hull.surface):
        raise ScanError("the hull's surface has 0 voxels; expected some: carve with larger ones")
    pictures = [_picture(view) for view in views]
    angles = _angles(views, hull.middle)

    def one(i: int) -> np.ndarray:
        chosen = choose_neighbours(angles, i, config)
        return _depth(views[i], pictures[i], [pictures[j] for j in chosen], hull, config)

    with ThreadPoolExecutor(os.cpu_count()) as pool:  # numpy and OpenCV release the lock
        raw = list(pool.map(one, range(len(views))))
    with_depth = [replace(view, depth=depth) for view, depth in zip(views, raw)]
    return [replace(view, depth=_agreed(with_depth, i, angles, config))
            for i, view in enumerate(with_depth)]


def _picture(view: View) -> Picture:
    if view.color is None:
        raise ViewError("no_color", "the view has no colour image; stereo expects one")
    grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return Picture(grey, view.intrinsics.K, view.T_world_camera)


def _angles(views: list[View], middle: np.ndarray) -> np.ndarray:
    """(n, n) angles between the lines of sight to one point, rad."""
    away = np.array([view.T_world_camera[:3, 3] for view in views]) - middle
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return np.arccos(np.clip(away @ away.T, -1, 1))


def choose_neighbours(angles: np.ndarray, i: int, config: StereoConfig) -> list[int]:
    """Views to compare view `i` with: at a useful angle, and apart from each other.

    Args:
        angles: (n, n) between lines of sight, rad.

    Returns:
        One or more indices; the nearest ones where none is at a useful angle.
    """
    wanted = config.min_angle + 0.35 * (config.max_angle - config.min_angle)
    order = [int(j) for j in np.argsort(np.abs(angles[i] - wanted)) if j != i]
    useful = [j for j in order if config.min_angle <= angles[i, j] <= config.max_angle]
    chosen: list[int] = []
    for apart in (config.min_angle, 0.0):  # from several sides first: what one hides, one shows
        for j in useful:
            if len(chosen) < config.neighbours and j not in chosen \
                    and all(angles[j, other] >= apart for other in chosen):
                chosen.append(j)
    return chosen or order[:2]


def hull_bounds(view: View, hull: VisualHull) -> tuple[np.ndarray, np.ndarray]:
    """Nearest and farthest depth of the hull at every pixel: (h, w) float32 metres each, 0 where
    the hull is not."""
    k = view.intrinsics
    pixels = geometry.project_into(view, hull.surface)
    near = np.full((k.height, k.width), np.inf, np.float32)
    far = np.zeros((k.height, k.width), np.float32)
    if not pixels.inside.any():
        return far, far
    z = pixels.depth.astype(np.float32)
    np.minimum.at(near, (pixels.rows, pixels.cols), z - hull.voxel_size)
    np.maximum.at(far, (pixels.rows, pixels.cols), z + hull.voxel_size)
    # Each voxel covers several pixels; a pixel more keeps the surface inside the bounds.
    reach = 1 + int(np.ceil(hull.voxel_size * k.fx / np.median(z)))
    kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
    near, far = cv2.erode(near, kernel), cv2.dilate(far, kernel)
    return np.where(far > 0, near, 0).astype(np.float32), far


def _search(view: View, hull: VisualHull, config: StereoConfig) -> tuple[np.ndarray, np.ndarray]:
    """Bounds of the depth that is looked for: the hull's, and around it those of the support."""
    labels = require_labels(view)
    near, far = hull_bounds(view, hull)
    shown = np.isin(labels, (CONTAINER, PARTS)) & (far > 0)
    # Windows and paths carry a rim's depth over its edge: what lies next to it is left open.
    rim = cv2.dilate((labels == CONTAINER).astype(np.uint8), np.ones((2 * config.edge + 1,) * 2))
    shown &= (labels == CONTAINER) | (rim == 0)
    if not shown.any():
        return np.zeros_like(near), np.zeros_like(far)
    low, high = float(near[shown].min()), float(far[shown].max())
    near, far = np.where(shown, near, 0), np.where(shown, far, 0)
    away = cv2.distanceTransform((~shown).astype(np.uint8), cv2.DIST_L2, 5)
    side = config.support * max(np.ptp(np.nonzero(shown), axis=1))
    around = (away > config.edge) & (away <= side) & (labels == BACKGROUND)
    near[around], far[around] = low, high + _BEHIND * (high - low)
    return near, far


def _depth(view: View, picture: Picture, neighbours: list[Picture], hull: VisualHull,
           config: StereoConfig) -> np.ndarray:
    """(h, w) float32 metres, 0 unknown: the depth on which the pictures agree best."""
    near, far = _search(view, hull, config)
    out = np.zeros_like(near)
    rows, cols = np.nonzero(far)
    if not len(rows):
        return out
    pad = 4 * config.radius
    window = (slice(max(rows.min() - pad, 0), rows.max() + pad + 1),
              slice(max(cols.min() - pad, 0), cols.max() + pad + 1))
    K = picture.K.copy()
    K[:2, 2] -= window[1].start, window[0].start
    part = Picture(np.ascontiguousarray(picture.grey[window]), K, picture.T_world_camera)
    near, far = near[window], far[window]
    planes = _planes(view, neighbours, hull, float(near[far > 0].min()), float(far.max()))
    with np.errstate(divide="ignore"):
        low, high = np.where(far > 0, 1 / far, np.inf), 1 / near
    allowed = (planes[:, None, None] >= low) & (planes[:, None, None] <= high)
    cost = sweep(part, neighbours, planes, allowed, config.radius)
    position, margin = best_planes(aggregate(cost, part.grey, _SMALL, _LARGE), allowed)
    good = (position >= 0) & (margin >= config.min_margin)
    position = _without_speckles(np.where(good, position, -1), part.grey.size)
    found = np.interp(position, np.arange(len(planes)), planes)
    out[window] = np.where(position >= 0, 1 / found, 0)
    return out


def _planes(view: View, neighbours: list[Picture], hull: VisualHull, near: float, far: float
            ) -> np.ndarray:
    """(d,) inverse depths, 1/m, from far to near; steps of about a pixel at the widest angle."""
    ray = geometry.apply(geometry.inverse(view.T_world_camera), hull.middle)
    ends = geometry.apply(view.T_world_camera, np.stack([ray / ray[2] * near, ray / ray[2] * far]))
    lengths = []
    for other in neighbours:
        local = geometry.apply(geometry.inverse(other.T_world_camera), ends) @ other.K.T
        lengths.append(np.linalg.norm(np.diff(local[:, :2] / local[:, 2:], axis=0)))
    count = int(np.clip(np.max(lengths), _MIN_PLANES, _MAX_PLANES))
    return np.linspace(1 / far, 1 / near, count)


def _without_speckles(position: np.ndarray, pixels: int) -> np.ndarray:
    """(h, w) positions among the planes; -1 for small islands that stand apart, smoothed."""
    smooth = cv2.medianBlur(position.astype(np.float32), 3)
    position = np.where((position >= 0) & (smooth >= 0), smooth, -1)
    steps = np.round(position * _LEVELS).astype(np.int16)
    cv2.filterSpeckles(steps, -_LEVELS, max(20, pixels // 5000), 2 * _LEVELS)
    return np.where(steps >= 0, position, -1)


def _agreed(views: list[View], i: int, angles: np.ndarray, config: StereoConfig) -> np.ndarray:
    """(h, w) float32 depth of view `i`, metres, 0 where too few others agree or as many of
    them look through it."""
    depth = views[i].depth
    assert depth is not None  # for the type checker
    rows, cols = np.nonzero(depth)
    points = geometry.apply(views[i].T_world_camera,
                            geometry.unproject(depth, views[i].intrinsics)[rows, cols])
    agree, through = np.zeros(len(rows), int), np.zeros(len(rows), int)
    for j in np.nonzero(angles[i] <= 1.5 * config.max_angle)[0]:
        other = views[j].depth
        assert other is not None  # for the type checker
        pixels = geometry.project_into(views[j], points)
        measured, inside = other[pixels.rows, pixels.cols], pixels.inside
        behind = np.zeros(len(points))
        behind[inside] = np.where(measured > 0, measured / pixels.depth - 1, np.nan)
        agree += (j != i) & inside & (np.abs(behind) <= config.tolerance)
        through += inside & (behind > 3 * config.tolerance)
    good = (agree >= config.min_agree) & (agree > through)
    out = np.zeros_like(depth)
    out[rows[good], cols[good]] = depth[rows[good], cols[good]]
    return out
