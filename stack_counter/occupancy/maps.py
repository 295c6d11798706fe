"""What the gamma-network reads: the stack's surface with all lengths measured in parts.

With l = v**(1/3) spanning a fixed number of pixels and heights in l, a 5 mm nut and a 50 mm nut
look the same. Training and run time both go through `stack_maps` and `channels`.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError
from stack_counter.types import PARTS, KeyView, StackVolume

PIXELS_PER_LENGTH = 8
TILE = 112  # pixels: 14 l
CHANNELS = 4  # local height, validity, distance to the wall, height above the inner surface
_WALL_REACH = 3.0  # l; farther walls do not matter, and a heap has none
_LOCAL = 1.5  # l; standard deviation of the weights of a height's surroundings
_LARGEST_MAP = 2048  # pixels a side; parts so small beside the container are not resolved


@dataclass(frozen=True)
class StackMaps:
    """A stack in parts' lengths: (rows, cols) arrays of `PIXELS_PER_LENGTH` pixels an l.

    Attributes:
        top: float32, highest surface over the support plane, l; 0 where not valid.
        height: float32, the same over the inner surface, l, at least 0; 0 where not valid.
        valid: bool, over the opening (heap: over the stack).
        wall: float32, distance to the wall, l, at most `_WALL_REACH`, which is also what a heap
            has.
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
        ScanError: no map, none of it valid, or parts too small for it.
    """
    if volume.top is None or volume.inner is None:
        raise ScanError("no top-surface map to read; expected one: the scan has no depth")
    length = unit_volume ** (1 / 3)
    top, inner = volume.top.heights, volume.inner.heights
    valid = np.isfinite(top) & np.isfinite(inner)
    if not valid.any():
        raise ScanError(f"0 of {top.size} cells of the top surface are finite; expected some")
    scale = volume.top.pitch * PIXELS_PER_LENGTH / length
    if max(top.shape) * scale > _LARGEST_MAP:
        raise ScanError(f"the stack is {max(top.shape) * volume.top.pitch / length:.0f} part "
                        f"lengths wide; expected at most {_LARGEST_MAP // PIXELS_PER_LENGTH}")
    top, inner = (_resampled(_extended(a, valid) / length, scale) for a in (top, inner))
    grown = _resampled(valid.astype(np.float32), scale) > 0.5
    return make_maps(top, inner, grown, walled=volume.container.kind != "none")


def make_maps(top: np.ndarray, inner: np.ndarray, valid: np.ndarray, walled: bool) -> StackMaps:
    """Maps from (rows, cols) surfaces in l at the final resolution; `walled`: in a container."""
    if walled:
        inside = np.pad(valid, 1).astype(np.uint8)
        wall = cv2.distanceTransform(inside, cv2.DIST_L2, 5)[1:-1, 1:-1] / PIXELS_PER_LENGTH
        wall = np.minimum(wall, _WALL_REACH)
    else:
        wall = np.full(valid.shape, _WALL_REACH, np.float32)
    height = np.where(valid, np.maximum(top - inner, 0), 0).astype(np.float32)
    return StackMaps(np.where(valid, top, 0).astype(np.float32), height, valid,
                     np.where(valid, wall, 0).astype(np.float32))


def network_channels(maps: StackMaps) -> np.ndarray:
    """(CHANNELS, rows, cols) float32: what the network's first layer reads."""
    valid = maps.valid.astype(np.float32)
    sigma = _LOCAL * PIXELS_PER_LENGTH
    side = int(2 * sigma) | 1
    weight, total = valid, maps.top * valid
    for _ in range(2):  # two box filters: near a Gaussian, at any width in the same time
        weight, total = (cv2.blur(a, (side, side), borderType=cv2.BORDER_CONSTANT)
                         for a in (weight, total))
    local = np.clip(maps.top - total / np.maximum(weight, 1e-3), -3, 3)
    return np.stack([local * valid, valid, maps.wall / _WALL_REACH,
                     np.log1p(maps.height) / 2]).astype(np.float32)


def tiles(maps: StackMaps) -> list[StackMaps]:
    """Square pieces of TILE pixels that cover the stack evenly; small stacks are padded."""
    rows, cols = np.nonzero(maps.valid)
    return [crop(maps, row, col) for row in _starts(rows.min(), rows.max() + 1)
            for col in _starts(cols.min(), cols.max() + 1)]


def crop(maps: StackMaps, row: int, col: int) -> StackMaps:
    """The tile from a corner on, which may lie outside: what is beyond the maps is not valid."""
    def cut(a: np.ndarray) -> np.ndarray:
        out = np.zeros((TILE, TILE), a.dtype)
        r0, c0 = max(row, 0), max(col, 0)
        part = a[r0:row + TILE, c0:col + TILE]
        out[r0 - row:r0 - row + part.shape[0], c0 - col:c0 - col + part.shape[1]] = part
        return out

    return StackMaps(cut(maps.top), cut(maps.height), cut(maps.valid), cut(maps.wall))


def surface_features(maps: StackMaps) -> np.ndarray:
    """(6,) features that say whether a surface is of a kind seen before: logs of mean height, of
    the smaller side, of V in parts, and of how uneven the surface is about its surroundings, from
    pixel to pixel, and bent.
    """
    local, inside = (
        network_channels(maps)[0],
        cv2.erode(maps.valid.astype(np.uint8), np.ones((5, 5))) > 0,
    )
    if not inside.any():
        inside = maps.valid
    step = np.abs(np.diff(local, axis=1, prepend=local[:, :1]))[inside]
    bend = np.abs(np.diff(local, 2, axis=1, prepend=local[:, :2]))[inside]
    values = [maps.height[maps.valid].mean(), min(maps.valid.shape) / PIXELS_PER_LENGTH,
              maps.height.sum() / PIXELS_PER_LENGTH**2, local[inside].std(), step.mean(),
              bend.mean()]
    return np.log(np.array(values, float) + 1e-3)


def key_view_maps(volume: StackVolume, unit_volume: float) -> StackMaps:
    """Maps of the key view alone: depth along its axis, neither floor nor wall being known.

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
    if np.count_nonzero(parts) < TILE:
        raise ScanError(f"{np.count_nonzero(parts)} pixels of the key view show parts with depth; "
                        f"expected at least {TILE}")
    pitch = unit_volume ** (1 / 3) / PIXELS_PER_LENGTH
    points = geometry.unproject(view.depth, view.intrinsics)[parts] / pitch
    low = points.min(axis=0)
    cols, rows = (points[:, :2] - low[:2]).astype(int).T
    shape = (int(rows.max()) + 1, int(cols.max()) + 1)
    if max(shape) > _LARGEST_MAP:
        raise ScanError(f"the key view is {max(shape) // PIXELS_PER_LENGTH} part lengths wide; "
                        f"expected at most {_LARGEST_MAP // PIXELS_PER_LENGTH}")
    far = np.float32(points[:, 2].max())
    nearest = np.full(shape, far, np.float32)
    np.minimum.at(nearest, (rows, cols), points[:, 2].astype(np.float32))
    hit = np.zeros(shape, bool)
    hit[rows, cols] = True
    spacing = max(float(np.sqrt(np.prod(shape) / len(points))), 1.0)
    around = np.ones((2 * int(np.ceil(spacing)) + 1,) * 2, np.uint8)
    valid = cv2.morphologyEx(hit.astype(np.uint8), cv2.MORPH_CLOSE, around) > 0
    top = (far - _extended(nearest, hit)) / PIXELS_PER_LENGTH
    top = (top - np.percentile(top[valid], 2)).astype(np.float32)
    return make_maps(top, np.zeros(shape, np.float32), valid, walled=False)


def picture_maps(view: KeyView, nearness: np.ndarray) -> StackMaps:
    """One tile of a key view in colour, as the paper's network reads it: the crop, whatever its
    scale, with (h, w) `nearness` as its height.

    Raises:
        ScanError: the view shows no parts.
    """
    parts = view.labels == PARTS
    if not parts.any():
        raise ScanError("0 pixels of the key view show parts; expected some")
    scale = TILE / max(parts.shape)
    top, valid = (_resampled(a.astype(np.float32), scale) for a in (nearness, parts))
    maps = make_maps(top, np.zeros_like(top), valid > 0.5, walled=False)
    return crop(maps, (top.shape[0] - TILE) // 2, (top.shape[1] - TILE) // 2)


def _starts(low: int, high: int) -> list[int]:
    count = max(1, -(-(high - low - TILE // 4) // (TILE - TILE // 4)))
    if count == 1:
        return [(low + high - TILE) // 2]
    return [int(round(x)) for x in np.linspace(low, high - TILE, count)]


def _extended(surface: np.ndarray, valid: np.ndarray) -> np.ndarray:
    """Surface with cells that are not valid taken from the nearest that is: resampling must not
    mix in what is not there.
    """
    if valid.all():
        return surface
    _, names = cv2.distanceTransformWithLabels(
        (~valid).astype(np.uint8), cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    by_name = np.zeros(names.max() + 1, np.float32)
    by_name[names[valid]] = surface[valid]
    return by_name[names]


def _resampled(surface: np.ndarray, scale: float) -> np.ndarray:
    rows, cols = (max(int(round(n * scale)), 1) for n in surface.shape)
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    return cv2.resize(surface.astype(np.float32), (cols, rows), interpolation=how)
