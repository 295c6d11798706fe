# SPDX-License-Identifier: Apache-2.0
"""Depth maps from posed pictures alone, bounded by the hull of their labels.

    hull = carve_visual_hull(views, voxel_size, min_share)
    views = depth_from_pictures(views, hull)    # the same views with depth

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
from stack_counter.multiview.plane_sweep import (
    Picture,
    aggregate_paths,
    find_best_planes,
    sweep_planes,
)
from stack_counter.multiview.search_bounds import search_bounds
from stack_counter.multiview.visual_hull import VisualHull
from stack_counter.types import View


@dataclass(frozen=True)
class StereoSettings:
    """How depth is computed from pictures; all chosen.

    Attributes:
        neighbours: number of pictures that a view is compared with.
        min_angle, max_angle: range of the angle between the lines of sight of two views to the
            stack at which they are compared, rad.
        angle_share: where in that range the preferred angle lies, 0 to 1.
        radius: of the correlation window, pixels.
        min_planes, max_planes: range of the number of depths that are tried.
        step_cost, jump_cost: costs of a step by one plane and of a larger jump between
            neighbouring pixels.
        min_margin: lowest share by which the second best depth must cost more.
        speckle_levels: steps between two planes in which islands are told apart.
        min_speckle_px: smallest island that is kept, pixels.
        pixels_per_speckle_px: the same for large pictures: one pixel for so many of the picture.
        tolerance: relative difference at which depths of two views agree.
        through_tolerances: relative difference, in tolerances, beyond which a view looks through
            a point.
        agree_angle: largest angle, in `max_angle`, between views that are checked against each
            other.
        min_agree: number of other views that must agree.
    """

    neighbours: int = 5
    min_angle: float = float(np.deg2rad(5))
    max_angle: float = float(np.deg2rad(30))
    angle_share: float = 0.35
    radius: int = 1
    min_planes: int = 16
    max_planes: int = 224
    step_cost: int = 60
    jump_cost: int = 600
    min_margin: float = 0.02
    speckle_levels: int = 16
    min_speckle_px: int = 20
    pixels_per_speckle_px: int = 5000
    tolerance: float = 0.01
    through_tolerances: float = 3.0
    agree_angle: float = 1.5
    min_agree: int = 2


SETTINGS = StereoSettings()


def depth_from_pictures(views: list[View], hull: VisualHull, settings: StereoSettings = SETTINGS
                        ) -> list[View]:
    """Computes the depth of views by multi-view stereo on their colour images.

    Args:
        views: pinhole views with colour, labels and poses.
        hull: space that their labels leave; the surface is searched in it.
        settings: how depth is computed.

    Returns:
        The views; `depth` is (h, w) float32 metres along optical z, 0 where unknown. A ring of
        background around the stack has depth where it was measured.

    Raises:
        ViewError: reason `no_color` or `no_labels`, if a view lacks them.
        ScanError: fewer than three views, or an empty surface of the hull.
    """
    if len(views) < 3:
        raise ScanError(f"{len(views)} views; stereo expects at least 3")
    if not len(hull.surface):
        raise ScanError("the hull's surface has 0 voxels; expected some: carve with larger ones")
    pictures = [_grey_picture(view) for view in views]
    angles = _viewing_angles(views, hull.middle)

    def compute_depth(i: int) -> np.ndarray:
        neighbours = [pictures[j] for j in choose_neighbours(angles, i, settings)]
        return _match_picture(views[i], pictures[i], neighbours, hull, settings)

    # Match every picture with its neighbours; numpy and OpenCV release the interpreter's lock.
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        depths = list(pool.map(compute_depth, range(len(views))))
    # Keep the depth on which several views agree.
    with_depth = [replace(view, depth=depth) for view, depth in zip(views, depths)]
    return [replace(view, depth=_consistent_depth(with_depth, i, angles, settings))
            for i, view in enumerate(with_depth)]


def _grey_picture(view: View) -> Picture:
    """Returns the grey levels of a view with its camera."""
    if view.color is None:
        raise ViewError("no_color", "the view has no colour image; stereo expects one")
    grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    return Picture(grey, view.intrinsics.K, view.T_world_camera)


def _viewing_angles(views: list[View], middle: np.ndarray) -> np.ndarray:
    """Returns (n, n) angles between the views' lines of sight to one (3,) point, rad."""
    away = np.array([view.T_world_camera[:3, 3] for view in views]) - middle
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    return np.arccos(np.clip(away @ away.T, -1, 1))


def choose_neighbours(angles: np.ndarray, i: int, settings: StereoSettings) -> list[int]:
    """Chooses the views to compare view `i` with: at a useful angle, and apart from each other.

    Args:
        angles: (n, n) between lines of sight, rad.
        i: index of the view.
        settings: number of neighbours, and useful angles.

    Returns:
        One or more indices; the nearest ones where none is at a useful angle.
    """
    # Sort the views by how useful their angle is.
    preferred = settings.min_angle + settings.angle_share * (
        settings.max_angle - settings.min_angle)
    order = [int(j) for j in np.argsort(np.abs(angles[i] - preferred)) if j != i]
    useful = [j for j in order if settings.min_angle <= angles[i, j] <= settings.max_angle]
    # Take them from several sides first: what one hides, another shows.
    chosen: list[int] = []
    for apart in (settings.min_angle, 0.0):
        for j in useful:
            if len(chosen) < settings.neighbours and j not in chosen \
                    and all(angles[j, other] >= apart for other in chosen):
                chosen.append(j)
    return chosen or order[:2]


def _match_picture(view: View, picture: Picture, neighbours: list[Picture], hull: VisualHull,
                   settings: StereoSettings) -> np.ndarray:
    """Returns the depth on which a picture agrees best with its neighbours.

    Returns:
        (h, w) float32 metres, 0 where unknown.
    """
    near, far = search_bounds(view, hull)
    out = np.zeros_like(near)
    rows, cols = np.nonzero(far)
    if not len(rows):
        return out
    # Crop to where depth is searched.
    pad = 4 * settings.radius
    window = (slice(max(rows.min() - pad, 0), rows.max() + pad + 1),
              slice(max(cols.min() - pad, 0), cols.max() + pad + 1))
    K = picture.K.copy()
    K[:2, 2] -= window[1].start, window[0].start
    part = Picture(np.ascontiguousarray(picture.grey[window]), K, picture.T_world_camera)
    near, far = near[window], far[window]
    # Compare the pictures on planes through the bounds.
    planes = _inverse_depths(view, neighbours, hull, float(near[far > 0].min()),
                             float(far.max()), settings)
    with np.errstate(divide="ignore"):
        low, high = np.where(far > 0, 1 / far, np.inf), 1 / near
    allowed = (planes[:, None, None] >= low) & (planes[:, None, None] <= high)
    cost = sweep_planes(part, neighbours, planes, allowed, settings.radius)
    # Aggregate the costs along paths, and take the clear minima.
    total = aggregate_paths(cost, part.grey, settings.step_cost, settings.jump_cost)
    best = find_best_planes(total, allowed)
    good = (best.position >= 0) & (best.margin >= settings.min_margin)
    position = _remove_speckles(np.where(good, best.position, -1), part.grey.size, settings)
    # Turn positions among the planes into depth.
    inverse_depth = np.interp(position, np.arange(len(planes)), planes)
    out[window] = np.where(position >= 0, 1 / inverse_depth, 0)
    return out


def _inverse_depths(view: View, neighbours: list[Picture], hull: VisualHull, near: float,
                    far: float, settings: StereoSettings) -> np.ndarray:
    """Returns inverse depths in steps of about a pixel in the neighbour that moves most.

    Args:
        view: the reference.
        neighbours: pictures that it is compared with.
        hull: its middle is on the line whose pixels are counted.
        near, far: bounds of the depth, metres.
        settings: bounds of the number.

    Returns:
        (d,) float64, 1/m, from far to near.
    """
    # Project the part of the line of sight between the bounds into the neighbours.
    ray = geometry.apply(geometry.inverse(view.T_world_camera), hull.middle)
    ends = geometry.apply(view.T_world_camera, np.stack([ray / ray[2] * near, ray / ray[2] * far]))
    lengths = []
    for other in neighbours:
        local = geometry.apply(geometry.inverse(other.T_world_camera), ends) @ other.K.T
        lengths.append(np.linalg.norm(np.diff(local[:, :2] / local[:, 2:], axis=0)))
    # Take a plane for each pixel of the longest.
    count = int(np.clip(np.max(lengths), settings.min_planes, settings.max_planes))
    return np.linspace(1 / far, 1 / near, count)


def _remove_speckles(position: np.ndarray, pixels: int, settings: StereoSettings) -> np.ndarray:
    """Smooths positions among the planes, and removes small islands that stand apart.

    Args:
        position: (h, w) float32, -1 where unknown.
        pixels: number of pixels of the picture.
        settings: what an island is.

    Returns:
        (h, w) float32, -1 where unknown or removed.
    """
    levels = settings.speckle_levels
    smooth = cv2.medianBlur(position.astype(np.float32), 3)
    position = np.where((position >= 0) & (smooth >= 0), smooth, -1)
    steps = np.round(position * levels).astype(np.int16)
    smallest = max(settings.min_speckle_px, pixels // settings.pixels_per_speckle_px)
    cv2.filterSpeckles(steps, -levels, smallest, 2 * levels)
    return np.where(steps >= 0, position, -1)


def _consistent_depth(views: list[View], i: int, angles: np.ndarray, settings: StereoSettings
                      ) -> np.ndarray:
    """Returns the depth of view `i` on which enough other views agree, and more than look through.

    Args:
        views: with depth.
        i: index of the view.
        angles: (n, n) between lines of sight, rad.
        settings: what agreement is.

    Returns:
        (h, w) float32 metres, 0 elsewhere.
    """
    depth = views[i].depth
    assert depth is not None  # for the type checker
    rows, cols = np.nonzero(depth)
    points = geometry.apply(views[i].T_world_camera,
                            geometry.unproject(depth, views[i].intrinsics)[rows, cols])
    # Count the views that measured the same depth, and those that measured more.
    agree, through = np.zeros(len(rows), int), np.zeros(len(rows), int)
    for j in np.nonzero(angles[i] <= settings.agree_angle * settings.max_angle)[0]:
        other = views[j].depth
        assert other is not None  # for the type checker
        pixels = geometry.project_into(views[j], points)
        measured, inside = other[pixels.rows, pixels.cols], pixels.inside
        behind = np.zeros(len(points))
        behind[inside] = np.where(measured > 0, measured / pixels.depth - 1, np.nan)
        agree += (j != i) & inside & (np.abs(behind) <= settings.tolerance)
        through += inside & (behind > settings.through_tolerances * settings.tolerance)
    # Keep what is seen by enough of them.
    good = (agree >= settings.min_agree) & (agree > through)
    out = np.zeros_like(depth)
    out[rows[good], cols[good]] = depth[rows[good], cols[good]]
    return out
