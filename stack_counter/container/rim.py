"""Finds the rim of an open container: a level ring around whatever stands on the support plane."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from stack_counter.container.wall_fit import fit_outline
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall, WallShape, fourier
from stack_counter.types import HeightMap

_LEVEL = 0.003  # how level a rim is, m
_BAND = 0.006  # how far from the outline the rim is looked for, m
_SECTORS = 180  # around the rim, each with one outermost point
_CLOSE = 0.003  # how near such a point must be to a form's outline to speak for it, m
_SIMPLER = 0.06  # share of the sectors that a richer form must explain better
_PROFILE = 0.0005  # step of the profile across the rim, m
_OUTSIDE = 0.004  # where that profile begins, m
_CREST = 0.014  # of it, in which the rim is surely reached, m
_BESIDE = 0.006  # width of the strip inside the rim that is looked at for its fall, m


@dataclass(frozen=True)
class Rim:
    """A level ring.

    Attributes:
        form: its outer outline.
        height: above the support plane, metres.
        share: of its sectors in which the ring was seen on that outline.
        drop_share: of its sectors in which the surface falls on the ring's inner side.
        width: from the outline to that fall, metres; NaN where parts hide it.
    """

    form: WallShape
    height: float
    outline_share: float
    inner_drop_share: float
    width: float


def find_rim(top: HeightMap, lowest: float, kind: str) -> Rim | None:
    """The rim of the largest thing in the map; None where nothing stands.

    Args:
        top: highest surface, heights above the support plane.
        lowest: what stands less high is not looked at, metres.
        kind: `box`, `round`, `free`, or `auto` for the simplest that fits.
    """
    points, center, height = rim_points(top, lowest)
    if not len(points):
        return None
    best, best_share = None, -1.0
    for form in _first_guesses(points, center, kind):
        form = fit_outline(form, points, max(top.pitch, 0.0015) / 2)
        share = rim_share(form, points, top.pitch)
        if share > best_share + (_SIMPLER if best is not None else 0):
            best, best_share = form, share
    assert best is not None  # for the type checker
    drop_share, outer, inner = _edges(top, best, height)
    return Rim(best.moved(outer), height, best_share, drop_share, inner - outer)


def rim_points(top: HeightMap, lowest: float, height: float = 0.0
               ) -> tuple[np.ndarray, np.ndarray, float]:
    """Outermost points of the rim of the largest thing in the map.

    Args:
        top: highest surface, heights above the support plane.
        lowest: what stands less high is not looked at, metres.
        height: of the rim above the support plane, metres; 0: found.

    Returns:
        At most one point in each sector, (n, 2) metres in the world (n = 0 where nothing stands),
        their middle (2,), and the rim's height.
    """
    ring, height = _level_ring(top, lowest, height)
    if np.count_nonzero(ring) < 20:
        return np.zeros((0, 2)), np.zeros(2), height
    points, center = _outermost(ring, top.pitch)
    T = top.T_world_map
    return points @ T[:2, :2].T + T[:2, 3], T[:2, :2] @ center + T[:2, 3], height


def rim_share(form: WallShape, points: np.ndarray, pitch: float) -> float:
    """Share of the sectors whose rim point (of `rim_points`) lies on a form's outline."""
    inside = form.depth_inside(points, np.zeros(len(points)))
    return np.count_nonzero(np.abs(inside) < max(_CLOSE, pitch)) / _SECTORS


def _level_ring(top: HeightMap, lowest: float, height: float) -> tuple[np.ndarray, float]:
    """(rows, cols) bool of the cells level with the outer edge of the blob (or with a given
    height), and that height."""
    blob = np.nan_to_num(top.heights, nan=0.0) > lowest
    names, count = ndimage.label(ndimage.binary_closing(blob, iterations=2))
    if not count:
        return blob, 0.0
    blob &= names == np.argmax(np.bincount(names.ravel())[1:]) + 1
    filled = ndimage.binary_fill_holes(ndimage.binary_closing(blob, iterations=2))
    outline = filled & ~ndimage.binary_erosion(filled)
    heights = np.where(blob, top.heights, 0)
    if height:
        return blob & (np.abs(heights - height) < _LEVEL), height
    # A wall may be one cell wide: what counts is the highest thing next to the outline.
    highest = ndimage.maximum_filter(heights, size=2 * int(np.ceil(_BAND / top.pitch)) + 1)
    level = np.round(highest[outline] / 0.001).astype(int)
    votes = np.convolve(np.bincount(level), np.ones(3), mode="same")
    near = blob & (np.abs(heights - np.argmax(votes) * 0.001) < _LEVEL)
    height = float(np.median(heights[near])) if near.any() else 0.0
    return blob & (np.abs(heights - height) < _LEVEL), height


def _outermost(ring: np.ndarray, pitch: float) -> tuple[np.ndarray, np.ndarray]:
    """(n, 2) outermost edge of the ring in each sector, and (2,) its middle, map frame, metres."""
    rows, cols = np.nonzero(ring)
    cells = np.stack([cols + 0.5, rows + 0.5], axis=1) * pitch
    center = np.array(cv2.minAreaRect(cells.astype(np.float32))[0])
    away = cells - center
    r = np.linalg.norm(away, axis=1)
    sector = ((np.arctan2(away[:, 1], away[:, 0]) / (2 * np.pi) % 1) * _SECTORS).astype(int)
    order = np.lexsort((-r, sector % _SECTORS))
    _, first = np.unique(sector[order] % _SECTORS, return_index=True)
    last = order[first]
    outer = away[last] * (1 + pitch / 2 / np.maximum(r[last], pitch))[:, None]
    return center + outer, center


def _first_guesses(points: np.ndarray, center: np.ndarray, kind: str) -> list[WallShape]:
    (x, y), size, degrees = cv2.minAreaRect(points.astype(np.float32))
    away = points - center
    r, angle = np.linalg.norm(away, axis=1), np.arctan2(away[:, 1], away[:, 0])
    forms: dict[str, WallShape] = {
        "box": BoxWall(np.array([x, y, np.deg2rad(degrees), *size, 0.0])),
        "round": RoundWall(np.array([*center, np.median(r), 0.0, 0.0]))}
    free = FreeWall(np.zeros(27), center)
    waves = fourier(angle, 8)
    # A ridge keeps sectors without points from swinging.
    ridge = np.diag([0.0, *(0.3 * np.tile(np.arange(1, 9.0), 2))])
    coefficients = np.linalg.solve(waves.T @ waves + ridge, waves.T @ r)
    forms["free"] = FreeWall(np.concatenate([coefficients, free.params[17:]]), center)
    return list(forms.values()) if kind == "auto" else [forms[kind]]


def rim_height(top: HeightMap, form: WallShape, wall: float, height: float) -> float:
    """Height of a rim whose outline is known, above the map's plane, metres.

    Args:
        top: highest surface.
        form: its outline.
        wall: thickness of the wall, metres.
        height: about where it is, metres; returned where the rim does not show.
    """
    inside = _depth_inside(top, form)
    rim = top.heights.ravel()[(inside > -_OUTSIDE) & (inside < wall + _OUTSIDE)]
    for _ in range(2):  # what counts as level depends on the height
        level = rim[np.abs(rim - height) < _LEVEL]
        height = float(np.median(level)) if len(level) else height
    return height


def _depth_inside(top: HeightMap, form: WallShape) -> np.ndarray:
    """(rows * cols,) metres that the cells' middles lie inside a form's outline at the rim."""
    T = top.T_world_map
    rows, cols = np.mgrid[:top.heights.shape[0], :top.heights.shape[1]]
    xy = (np.stack([cols.ravel(), rows.ravel()], 1) + 0.5) * top.pitch @ T[:2, :2].T + T[:2, 3]
    return form.depth_inside(xy, np.zeros(len(xy)))


def _edges(top: HeightMap, form: WallShape, height: float) -> tuple[float, float, float]:
    """Share of the outline where the surface falls inside the ring, and the places of the ring's
    outer and inner edge, as distances inwards from the form's outline.

    An edge is where the share of cells level with the rim crosses half of what it is on the rim:
    parts that reach the rim's height here and there do not hide that.
    """
    inside = _depth_inside(top, form)
    band = (inside > -_OUTSIDE) & (inside < 0.2 * inside.max())
    at = ((inside[band] + _OUTSIDE) / _PROFILE).astype(int)
    above = top.heights.ravel()[band] - height
    cells = np.maximum(np.bincount(at), 1)
    level = np.bincount(at, np.abs(above) < _LEVEL) / cells
    level = np.convolve(level, np.ones(3) / 3, mode="same")
    crest = int(np.argmax(level[:int(_CREST / _PROFILE)]))
    low = level < level[crest] / 2
    begins, ends = np.nonzero(low[:crest])[0], crest + np.nonzero(low[crest:])[0]
    if not len(begins) or not len(ends):
        return 0.0, 0.0, np.nan
    lower = np.bincount(at, above < -_LEVEL) / cells
    beside = lower[ends[0] + 2:ends[0] + 2 + int(_BESIDE / _PROFILE)]

    def crossing(i: int) -> float:
        """Where the share is half the crest's between the bins i and i + 1, linearly."""
        part = (level[i] - level[crest] / 2) / (level[i] - level[i + 1])
        return (i + 0.5 + part) * _PROFILE - _OUTSIDE
    return (float(beside.mean()) if len(beside) else 0.0, crossing(int(begins[-1])),
            crossing(int(ends[0]) - 1))
