# SPDX-License-Identifier: Apache-2.0
"""Finds the rim of an open container: a level ring around whatever stands on the support plane."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from stack_counter.container.wall_fit import fit_outline
from stack_counter.container.wall_shapes import SETTINGS as SHAPE_SETTINGS
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall, fourier_basis
from stack_counter.types import HeightMap, WallShape


@dataclass(frozen=True)
class RimSettings:
    """How a rim is told from what it holds; all values are chosen.

    Attributes:
        level: largest distance of a level surface from the rim's height, m.
        height_step: step of the histogram of heights in which the rim's is found, m.
        band: distance from the blob's outline within which the rim is looked for, m.
        min_cells: least number of cells of a rim.
        sectors: sectors around the rim, each with one outermost point.
        close: distance from an outline within which such a point lies on it, m.
        simpler_share: share of the sectors that a richer shape must explain better.
        outline_std: least standard deviation of a rim point for the fit of an outline, m.
        ridge: strength of the penalty on a free-form outline's first guess, for each order.
        profile_step: step of the profile across the rim, m.
        profile_start: distance outside the outline at which that profile begins, m.
        crest_reach: length of the profile in which the rim is surely reached, m.
        widest_share: part of the opening's depth that the profile covers.
        strip: width of the strip inside the rim in which the surface may fall, m.
    """

    level: float = 0.003
    height_step: float = 0.001
    band: float = 0.006
    min_cells: int = 20
    sectors: int = 180
    close: float = 0.003
    simpler_share: float = 0.06
    outline_std: float = 0.00075
    ridge: float = 0.3
    profile_step: float = 0.0005
    profile_start: float = 0.004
    crest_reach: float = 0.014
    widest_share: float = 0.2
    strip: float = 0.006


SETTINGS = RimSettings()


@dataclass(frozen=True, eq=False)
class Rim:
    """A level ring.

    Attributes:
        outline: the wall shape whose rim runs along its outer edge.
        height: above the support plane, metres.
        outline_share: share of its sectors in which the ring was seen on that outline.
        inner_drop_share: share of its sectors in which the surface falls on the inner side.
        width: from the outline to that fall, metres; NaN where parts hide it.
    """

    outline: WallShape
    height: float
    outline_share: float
    inner_drop_share: float
    width: float


@dataclass(frozen=True, eq=False)
class RimPoints:
    """Outermost points of a rim, at most one in each sector.

    Attributes:
        xy: (n, 2) metres, world; n = 0 where nothing stands.
        center: (2,) metres, world, the middle of the ring.
        height: of the rim above the map's plane, metres.
    """

    xy: np.ndarray
    center: np.ndarray
    height: float


@dataclass(frozen=True, eq=False)
class _Ring:
    """Cells of a map that are level with a rim: (rows, cols) bool, and its height, metres."""

    cells: np.ndarray
    height: float


@dataclass(frozen=True)
class _RimEdges:
    """Edges of a ring as distances inwards from an outline, metres.

    Attributes:
        drop_share: share of the outline where the surface falls inside the ring.
        outer, inner: place of the outer and the inner edge; the inner one is NaN where parts hide
            it.
    """

    drop_share: float
    outer: float
    inner: float


def find_rim(top: HeightMap, min_height: float, kind: str) -> Rim | None:
    """Finds the rim of the largest thing in a map; None where nothing stands.

    Args:
        top: highest surface, heights above the support plane.
        min_height: what stands less high is left out, metres.
        kind: `box`, `round`, `free`, or `auto` for the simplest that fits.
    """
    points = find_rim_points(top, min_height)
    if not len(points.xy):
        return None
    # Fit each shape; a richer one must explain more of the rim.
    best, best_share = None, -1.0
    for shape in _first_guesses(points, kind):
        shape = fit_outline(shape, points.xy, rim_point_std(top.pitch))
        share = measure_outline_share(shape, points.xy, top.pitch)
        if share > best_share + (SETTINGS.simpler_share if best is not None else 0):
            best, best_share = shape, share
    assert best is not None  # for the type checker
    # Measure the ring's edges across that outline.
    edges = _find_edges(top, best, points.height)
    return Rim(outline=best.offset_inwards(edges.outer), height=points.height,
               outline_share=best_share, inner_drop_share=edges.drop_share,
               width=edges.inner - edges.outer)


def find_rim_points(top: HeightMap, min_height: float, height: float = 0.0) -> RimPoints:
    """Finds the outermost points of the rim of the largest thing in a map.

    Args:
        top: highest surface, heights above the support plane.
        min_height: what stands less high is left out, metres.
        height: of the rim above the support plane, metres; 0: found.
    """
    ring = _level_ring(top, min_height, height)
    if np.count_nonzero(ring.cells) < SETTINGS.min_cells:
        return RimPoints(np.zeros((0, 2)), np.zeros(2), ring.height)
    points, center = _outermost_points(ring.cells, top.pitch)
    T = top.T_world_map
    return RimPoints(points @ T[:2, :2].T + T[:2, 3], T[:2, :2] @ center + T[:2, 3], ring.height)


def measure_outline_share(shape: WallShape, xy: np.ndarray, pitch: float) -> float:
    """Share of the sectors whose rim point lies on a shape's outline.

    Args:
        shape: the outline.
        xy: (n, 2) as `RimPoints.xy`.
        pitch: side of a cell of the map that they were found in, metres.
    """
    inside = shape.depth_inside(xy, np.zeros(len(xy)))
    return np.count_nonzero(np.abs(inside) < max(SETTINGS.close, pitch)) / SETTINGS.sectors


def rim_point_std(pitch: float) -> float:
    """Standard deviation of a rim point in a map of that pitch, metres: half a cell."""
    return max(pitch / 2, SETTINGS.outline_std)


def measure_rim_height(top: HeightMap, shape: WallShape, thickness: float, height: float) -> float:
    """Measures the height of a rim whose outline is known, above the map's plane, metres.

    Args:
        top: highest surface.
        shape: its outline.
        thickness: of the wall, metres.
        height: expected, metres; returned where the rim does not show.
    """
    inside = map_depth_inside(top, shape)
    outside = SETTINGS.profile_start
    rim = top.heights.ravel()[(inside > -outside) & (inside < thickness + outside)]
    for _ in range(2):  # what counts as level depends on the height
        level = rim[np.abs(rim - height) < SETTINGS.level]
        height = float(np.median(level)) if len(level) else height
    return height


def map_depth_inside(top: HeightMap, shape: WallShape) -> np.ndarray:
    """Distance by which a map's cells lie inside a shape's outline at the rim.

    Args:
        top: whose cells are looked at.
        shape: the outline.

    Returns:
        (rows * cols,) metres, negative outside.
    """
    T = top.T_world_map
    rows, cols = np.mgrid[:top.heights.shape[0], :top.heights.shape[1]]
    xy = (np.stack([cols.ravel(), rows.ravel()], 1) + 0.5) * top.pitch @ T[:2, :2].T + T[:2, 3]
    return shape.depth_inside(xy, np.zeros(len(xy)))


def _level_ring(top: HeightMap, min_height: float, height: float) -> _Ring:
    """The cells level with the outer edge of the largest blob, or with a given height."""
    s = SETTINGS
    # The largest blob, and the outline of it with its holes filled.
    blob = np.nan_to_num(top.heights, nan=0.0) > min_height
    labels, count = ndimage.label(ndimage.binary_closing(blob, iterations=2))
    if not count:
        return _Ring(blob, 0.0)
    blob &= labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1
    heights = np.where(blob, top.heights, 0)
    if height:
        return _Ring(blob & (np.abs(heights - height) < s.level), height)
    filled = ndimage.binary_fill_holes(ndimage.binary_closing(blob, iterations=2))
    outline = filled & ~ndimage.binary_erosion(filled)
    # A wall may be one cell wide: what counts is the highest thing next to the outline.
    highest = ndimage.maximum_filter(heights, size=2 * int(np.ceil(s.band / top.pitch)) + 1)
    # The most frequent height along the outline, then the median of all that is level with it.
    level = np.round(highest[outline] / s.height_step).astype(int)
    votes = np.convolve(np.bincount(level), np.ones(3), mode="same")
    near = blob & (np.abs(heights - np.argmax(votes) * s.height_step) < s.level)
    height = float(np.median(heights[near])) if near.any() else 0.0
    return _Ring(blob & (np.abs(heights - height) < s.level), height)


def _outermost_points(ring: np.ndarray, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) outermost edge of the ring in each sector, and (2,) its middle, map frame, metres."""
    # Polar coordinates of the ring's cells around its middle.
    rows, cols = np.nonzero(ring)
    cells = np.stack([cols + 0.5, rows + 0.5], axis=1) * pitch
    center = np.array(cv2.minAreaRect(cells.astype(np.float32))[0])
    offsets = cells - center
    r = np.linalg.norm(offsets, axis=1)
    turn = np.arctan2(offsets[:, 1], offsets[:, 0]) / (2 * np.pi) % 1
    sector = (turn * SETTINGS.sectors).astype(int) % SETTINGS.sectors
    # The farthest cell of each sector, and its outer edge.
    order = np.lexsort((-r, sector))
    _, first = np.unique(sector[order], return_index=True)
    last = order[first]
    outer = offsets[last] * (1 + pitch / 2 / np.maximum(r[last], pitch))[:, None]
    return center + outer, center


def _first_guesses(points: RimPoints, kind: str) -> list[WallShape]:
    """Shapes near the rim, from the simplest to the richest: of one kind, or all for `auto`."""
    s = SETTINGS
    (x, y), size, degrees = cv2.minAreaRect(points.xy.astype(np.float32))
    offsets = points.xy - points.center
    r, angle = np.linalg.norm(offsets, axis=1), np.arctan2(offsets[:, 1], offsets[:, 0])
    # Fourier coefficients of the radius; a ridge keeps sectors without points from swinging.
    orders = SHAPE_SETTINGS.radius_orders
    basis = fourier_basis(angle, orders)
    ridge = np.diag([0.0, *(s.ridge * np.tile(np.arange(1, orders + 1.0), 2))])
    radii = np.linalg.solve(basis.T @ basis + ridge, basis.T @ r)
    guesses: dict[str, WallShape] = {
        "box": BoxWall(np.array([x, y, np.deg2rad(degrees), *size, 0.0])),
        "round": RoundWall(np.array([*points.center, np.median(r), 0.0, 0.0])),
        "free": FreeWall.from_outline(points.center, radii)}
    return list(guesses.values()) if kind == "auto" else [guesses[kind]]


def _find_edges(top: HeightMap, shape: WallShape, height: float) -> _RimEdges:
    """Finds the ring's edges across an outline.

    An edge is where the share of cells level with the rim crosses half of what it is on the rim:
    parts that reach the rim's height here and there do not hide that.
    """
    s = SETTINGS
    # Profile across the outline: share of cells level with the rim by distance inwards.
    inside = map_depth_inside(top, shape)
    band = (inside > -s.profile_start) & (inside < s.widest_share * inside.max())
    step = ((inside[band] + s.profile_start) / s.profile_step).astype(int)
    above = top.heights.ravel()[band] - height
    cells = np.maximum(np.bincount(step), 1)
    level = np.bincount(step, np.abs(above) < s.level) / cells
    level = np.convolve(level, np.ones(3) / 3, mode="same")
    # Its crest, and where it is lower than half of that on both sides.
    crest = int(np.argmax(level[:int(s.crest_reach / s.profile_step)]))
    low = level < level[crest] / 2
    begins, ends = np.nonzero(low[:crest])[0], crest + np.nonzero(low[crest:])[0]
    if not len(begins) or not len(ends):
        return _RimEdges(0.0, 0.0, np.nan)
    # Share of the cells in a strip inside the ring that lie lower.
    lower = np.bincount(step, above < -s.level) / cells
    strip = lower[ends[0] + 2:ends[0] + 2 + int(s.strip / s.profile_step)]

    def crossing(i: int) -> float:
        """Where the share is half the crest's between the bins i and i + 1, linearly."""
        part = (level[i] - level[crest] / 2) / (level[i] - level[i + 1])
        return (i + 0.5 + part) * s.profile_step - s.profile_start
    return _RimEdges(float(strip.mean()) if len(strip) else 0.0, crossing(int(begins[-1])),
                     crossing(int(ends[0]) - 1))
