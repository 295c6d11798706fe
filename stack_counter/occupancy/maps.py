# SPDX-License-Identifier: Apache-2.0
"""What the gamma-network reads: the stack's surface with all lengths measured in parts.

A part length is v**(1/3). With it spanning a fixed number of pixels and heights measured in it, a
5 mm nut and a 50 mm nut look the same. Training and run time both go through `stack_maps` and
`network_channels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.types import PARTS, KeyView, StackVolume

# The weights are learnt with these.
PIXELS_PER_LENGTH = 8  # a part length
TILE = 112  # side of a tile, pixels: 14 part lengths
_NARROWEST_PX = 2  # of a map: a surface's slope takes two pixels
CHANNELS = 4  # local height, validity, distance to the wall, height above the inner surface


@dataclass(frozen=True)
class MapSettings:
    """How surfaces become maps; chosen, and the weights are learnt with the first three.

    Attributes:
        wall_reach: distance, part lengths, beyond which walls do not matter; a heap has none.
        surroundings: standard deviation, part lengths, of the weights by which the surroundings
            of a height are averaged.
        local_limit: largest height over the surroundings, part lengths.
        largest_map: pixels a side; parts so small beside the container are not resolved.
        tallest: part lengths; ten times as high as the largest map is wide.
        fewest_key_view_pixels: pixels with parts and depth that a key view must have.
        key_view_floor: percentile of a key view's heights that counts as height 0.
    """

    wall_reach: float = 3.0
    surroundings: float = 1.5
    local_limit: float = 3.0
    largest_map: int = 2048
    tallest: float = 2560.0
    fewest_key_view_pixels: int = 112
    key_view_floor: float = 2.0


SETTINGS = MapSettings()


@dataclass(frozen=True, eq=False)
class StackMaps:
    """A stack in part lengths: (rows, cols) arrays, `PIXELS_PER_LENGTH` pixels a part length.

    Attributes:
        top: float32 highest surface over the support plane, part lengths; 0 where not valid.
        height: float32, the same over the inner surface, at least 0; 0 where not valid.
        valid: bool, over the opening (heap: over the stack).
        wall: float32 distance to the wall, part lengths, at most `MapSettings.wall_reach`, which
            is also what a heap has.
    """

    top: np.ndarray
    height: np.ndarray
    valid: np.ndarray
    wall: np.ndarray


def stack_maps(volume: StackVolume, unit_volume: float) -> StackMaps:
    """Resamples a reconstruction's maps.

    Args:
        volume: with top and inner surface.
        unit_volume: v, m3.

    Raises:
        ScanError: there is no map, none of it is valid, or the parts are too small for it.
    """
    if volume.top is None or volume.inner is None:
        raise ScanError("no top-surface map to read; expected one: the scan has no depth")
    part_length = unit_volume ** (1 / 3)
    top, inner = volume.top.heights, volume.inner.heights
    valid = np.isfinite(top) & np.isfinite(inner)
    if not valid.any():
        raise ScanError(f"0 of {top.size} cells of the top surface are finite; expected some")
    scale = volume.top.pitch * PIXELS_PER_LENGTH / part_length
    if max(top.shape) * scale > SETTINGS.largest_map:
        raise ScanError(f"the stack is {max(top.shape) * volume.top.pitch / part_length:.0f} part "
                        f"lengths wide; expected at most "
                        f"{SETTINGS.largest_map // PIXELS_PER_LENGTH}")
    if min(top.shape) * scale < _NARROWEST_PX:
        raise ScanError(f"the stack is {min(top.shape) * volume.top.pitch / part_length:.2g} part "
                        f"lengths wide; expected at least {_NARROWEST_PX / PIXELS_PER_LENGTH}")
    if not (height := float((top - inner)[valid].max()) / part_length) <= SETTINGS.tallest:
        raise ScanError(f"the stack is {height:.3g} part lengths high; expected at most "
                        f"{SETTINGS.tallest:.0f}")
    top, inner = (_resample(_fill_from_nearest(a, valid) / part_length, scale)
                  for a in (top, inner))
    valid = _resample(valid.astype(np.float32), scale) > 0.5
    return make_maps(top, inner, valid, walled=volume.container.kind != "none")


def make_maps(top: np.ndarray, inner: np.ndarray, valid: np.ndarray, walled: bool) -> StackMaps:
    """Makes maps of surfaces that have the final resolution.

    Args:
        top: (rows, cols) highest surface, part lengths.
        inner: (rows, cols) inner surface of the container, or the support plane, part lengths.
        valid: (rows, cols) bool, over the opening.
        walled: the stack stands in a container.
    """
    if walled:
        inside = np.pad(valid, 1).astype(np.uint8)
        wall = cv2.distanceTransform(inside, cv2.DIST_L2, 5)[1:-1, 1:-1] / PIXELS_PER_LENGTH
        wall = np.minimum(wall, SETTINGS.wall_reach)
    else:
        wall = np.full(valid.shape, SETTINGS.wall_reach, np.float32)
    height = np.where(valid, np.maximum(top - inner, 0), 0).astype(np.float32)
    return StackMaps(np.where(valid, top, 0).astype(np.float32), height, valid,
                     np.where(valid, wall, 0).astype(np.float32))


def network_channels(maps: StackMaps) -> np.ndarray:
    """(CHANNELS, rows, cols) float32: what the network's first layer reads."""
    valid = maps.valid.astype(np.float32)
    # Average the surroundings by two box filters: near a Gaussian, in the same time at any width.
    side = int(2 * SETTINGS.surroundings * PIXELS_PER_LENGTH) | 1
    weight, total = valid, maps.top * valid
    for _ in range(2):
        weight, total = (cv2.blur(a, (side, side), borderType=cv2.BORDER_CONSTANT)
                         for a in (weight, total))
    # Stack the height over them with the other channels.
    local = np.clip(maps.top - total / np.maximum(weight, 1e-3), -SETTINGS.local_limit,
                    SETTINGS.local_limit)
    return np.stack([local * valid, valid, maps.wall / SETTINGS.wall_reach,
                     np.log1p(maps.height) / 2]).astype(np.float32)


def split_into_tiles(maps: StackMaps) -> list[StackMaps]:
    """Cuts tiles that cover the stack evenly; what is smaller than a tile is padded."""
    rows, cols = np.nonzero(maps.valid)
    return [crop_tile(maps, row, col) for row in _tile_starts(rows.min(), rows.max() + 1)
            for col in _tile_starts(cols.min(), cols.max() + 1)]


def crop_tile(maps: StackMaps, row: int, col: int) -> StackMaps:
    """Cuts the tile from a corner on, which may lie outside; there the tile is not valid."""
    def cut(a: np.ndarray) -> np.ndarray:
        out = np.zeros((TILE, TILE), a.dtype)
        part = a[max(row, 0):row + TILE, max(col, 0):col + TILE]
        row_0, col_0 = max(-row, 0), max(-col, 0)
        out[row_0:row_0 + part.shape[0], col_0:col_0 + part.shape[1]] = part
        return out

    return StackMaps(cut(maps.top), cut(maps.height), cut(maps.valid), cut(maps.wall))


def surface_features(maps: StackMaps) -> np.ndarray:
    """Features by which a surface of a kind seen before is told from another.

    Returns:
        (6,) float64 logs of mean height, of the smaller side, of V in parts, and of how uneven
        the surface is about its surroundings, from pixel to pixel, and bent.
    """
    local = network_channels(maps)[0]
    # The border is left out: the surroundings are not valid there.
    inside = cv2.erode(maps.valid.astype(np.uint8), np.ones((5, 5))) > 0
    if not inside.any():
        inside = maps.valid
    step = np.abs(np.diff(local, axis=1, prepend=local[:, :1]))[inside]
    bend = np.abs(np.diff(local, 2, axis=1, prepend=local[:, :2]))[inside]
    values = [maps.height[maps.valid].mean(), min(maps.valid.shape) / PIXELS_PER_LENGTH,
              maps.height.sum() / PIXELS_PER_LENGTH**2, local[inside].std(), step.mean(),
              bend.mean()]
    return np.log(np.array(values, float) + 1e-3)


def stack_maps_of_key_view(volume: StackVolume, unit_volume: float) -> StackMaps:
    """Makes maps of the key view alone: heights along its axis, without floor and walls.

    Args:
        volume: with a key view that has depth.
        unit_volume: v, m3.

    Raises:
        ScanError: no key view, or one without depth on parts.
    """
    view = volume.key_view
    if view is None or view.depth is None:
        raise ScanError("no top-surface map and no depth in the key view; expected one of them")
    parts = (view.labels == PARTS) & (view.depth > 0)
    if np.count_nonzero(parts) < SETTINGS.fewest_key_view_pixels:
        raise ScanError(f"{np.count_nonzero(parts)} pixels of the key view show parts with depth; "
                        f"expected at least {SETTINGS.fewest_key_view_pixels}")
    # Put the points into cells across the view's axis, in pixels of the maps.
    pitch = unit_volume ** (1 / 3) / PIXELS_PER_LENGTH
    points = geometry.unproject(view.depth, view.intrinsics)[parts] / pitch
    cols, rows = (points[:, :2] - points.min(axis=0)[:2]).astype(int).T
    shape = (int(rows.max()) + 1, int(cols.max()) + 1)
    if max(shape) > SETTINGS.largest_map:
        raise ScanError(f"the key view is {max(shape) // PIXELS_PER_LENGTH} part lengths wide; "
                        f"expected at most {SETTINGS.largest_map // PIXELS_PER_LENGTH}")
    # Keep the nearest point of each cell.
    farthest = np.float32(points[:, 2].max())
    nearest = np.full(shape, farthest, np.float32)
    np.minimum.at(nearest, (rows, cols), points[:, 2].astype(np.float32))
    hit = np.zeros(shape, bool)
    hit[rows, cols] = True
    # Close the gaps between the points, and measure heights from the farthest parts up.
    valid = _close_gaps(hit, len(points))
    top = (farthest - _fill_from_nearest(nearest, hit)) / PIXELS_PER_LENGTH
    top = (top - np.percentile(top[valid], SETTINGS.key_view_floor)).astype(np.float32)
    return make_maps(top, np.zeros(shape, np.float32), valid, walled=False)


def picture_maps(view: KeyView, nearness: np.ndarray) -> StackMaps:
    """Makes one tile of a key view in colour, whatever its scale, as the paper's network reads it.

    Args:
        view: the crop to the parts.
        nearness: (h, w) float32 estimated for it, which serves as height.

    Raises:
        ScanError: the view shows no parts.
    """
    parts = view.labels == PARTS
    if not parts.any():
        raise ScanError("0 pixels of the key view show parts; expected some")
    scale = TILE / max(parts.shape)
    top, part_share = (_resample(a.astype(np.float32), scale) for a in (nearness, parts))
    maps = make_maps(top, np.zeros_like(top), part_share > 0.5, walled=False)
    return crop_tile(maps, (top.shape[0] - TILE) // 2, (top.shape[1] - TILE) // 2)


def _tile_starts(low: int, high: int) -> list[int]:
    """First pixels of tiles that cover [low, high) and overlap by a quarter or more."""
    count = max(1, -(-(high - low - TILE // 4) // (TILE - TILE // 4)))
    if count == 1:
        return [(low + high - TILE) // 2]
    return [int(round(x)) for x in np.linspace(low, high - TILE, count)]


def _close_gaps(hit: np.ndarray, points: int) -> np.ndarray:
    """(rows, cols) bool cells that points have hit, closed by their mean spacing."""
    spacing = max(float(np.sqrt(np.prod(hit.shape) / points)), 1.0)
    kernel = np.ones((2 * int(np.ceil(spacing)) + 1,) * 2, np.uint8)
    return cv2.morphologyEx(hit.astype(np.uint8), cv2.MORPH_CLOSE, kernel) > 0


def _fill_from_nearest(surface: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Fills cells that are not valid from the nearest that is, for resampling not to mix them."""
    if valid.all():
        return surface
    _, labels = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    by_label = np.zeros(labels.max() + 1, np.float32)
    by_label[labels[valid]] = surface[valid]
    return by_label[labels]


def _resample(surface: np.ndarray, scale: float) -> np.ndarray:
    """Scales (rows, cols) values to `scale` times as many cells a side."""
    rows, cols = (max(int(round(n * scale)), 1) for n in surface.shape)
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(surface.astype(np.float32), (cols, rows), interpolation=interpolation)
