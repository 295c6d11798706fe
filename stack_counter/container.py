"""Finds an upright box-shaped bin, at any position and yaw, from the surface seen from above.

The rim is what a bin has and a heap has not: a level ring with a drop on its inner side.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.errors import ScanError
from stack_counter.region import Region
from stack_counter.tsdf import TopView
from stack_counter.types import Container, HeightMap

_LEVEL = 0.003  # how level a rim is, m
_BAND = 0.006  # how far from the outline the rim is looked for, m
_STEP = 0.0005  # sampling across the rim, m
_REACH = 0.020  # how far on both sides of the first guess an edge is looked for, m
_MIN_HEIGHT = 0.02  # of a rim that is found by itself, m
_STRAIGHT = 0.004  # how straight an edge is, m
_MIN_RIM = 0.5  # share of the outline on which a rim must be seen
_MIN_DROP = 0.15  # share of the outline on which the drop inside the rim must be seen


@dataclass(frozen=True)
class _Rim:
    """A level rectangular ring in the world: frame at its centre on the support plane, outer
    size, height above the plane, the inner edges' distance from the outer ones (or NaN) for the
    sides -x, +x, -y, +y, and the shares of the outline where rim and drop were seen."""

    T_world_rim: np.ndarray
    outer: np.ndarray
    height: float
    walls: np.ndarray
    rim_share: float
    drop_share: float


def find_container(view: TopView, region: Region, pitch: float, config: ReconstructorConfig
                   ) -> Container:
    """The container as configured, or as found.

    Args:
        view: the fused surface.
        region: where to look; its `plane_z` is the support plane.
        pitch: side of a cell of the map that is searched, m: the voxel's.
        config: `container_*` settings; zeros are measured.

    Returns:
        A container of kind `box` or `none`. The floor's thickness is the configured one, else
        the wall's.

    Raises:
        ScanError: a box is configured and no rim is found.
    """
    if config.container_kind == "none":
        return no_container(region)
    if config.container_pose == "given":
        return _configured(config, region)
    rim = _find_rim(view, region, pitch)
    seen = rim is not None and rim.rim_share >= _MIN_RIM and (
        rim.drop_share >= _MIN_DROP or config.container_wall_m > 0
        or np.any(config.container_inner_size_m))
    if rim is not None and seen:
        return _from_rim(rim, config)
    if config.container_kind == "box":
        shares = (0.0, 0.0) if rim is None else (rim.rim_share, rim.drop_share)
        raise ScanError(f"no box-shaped rim found: level on {shares[0]:.0%} of the outline, drop "
                        f"inside on {shares[1]:.0%}; expected {_MIN_RIM:.0%} and {_MIN_DROP:.0%}")
    return no_container(region)


def no_container(region: Region) -> Container:
    """A heap: the frame stands on the support plane in the middle of the region."""
    centre = (region.low + region.high) / 2
    return Container("none", geometry.pose(np.eye(3), np.append(centre[:2], region.plane_z)))


def _upright(x: float, y: float, z: float, yaw: float) -> np.ndarray:
    c, s = np.cos(yaw), np.sin(yaw)
    return geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]), np.array([x, y, z]))


def _configured(config: ReconstructorConfig, region: Region) -> Container:
    if not all(config.container_inner_size_m):
        raise ScanError(f"container_inner_size_m is {config.container_inner_size_m}; a container "
                        "whose pose is given needs three sizes above 0")
    x, y, yaw = config.container_xyyaw
    a, b, height = config.container_inner_size_m
    return Container("box", _upright(x, y, region.plane_z, yaw), (a, b, height),
                     config.container_wall_m, config.container_floor_m or config.container_wall_m)


def _from_rim(rim: _Rim, config: ReconstructorConfig) -> Container:
    """Inner size from the inner edges; where parts hide one, from the other sides' walls."""
    measured = rim.walls[np.isfinite(rim.walls)]
    wall = config.container_wall_m or (float(np.median(measured)) if len(measured) else 0.0)
    walls = np.where(np.isfinite(rim.walls), rim.walls, wall)
    if config.container_wall_m:
        walls = np.full(4, wall)
    inner = rim.outer - [walls[0] + walls[1], walls[2] + walls[3]]
    centre = np.array([walls[0] - walls[1], walls[2] - walls[3], 0.0]) / 2
    T = rim.T_world_rim @ geometry.pose(np.eye(3), centre)
    floor = config.container_floor_m or wall
    height = rim.height - floor
    if np.any(config.container_inner_size_m):
        sides = np.array(config.container_inner_size_m[:2])
        height = config.container_inner_size_m[2]
        if (sides[0] > sides[1]) != (inner[0] > inner[1]):
            T = T @ _upright(0, 0, 0, np.pi / 2)
        inner = sides
        floor = config.container_floor_m or max(rim.height - height, 0.0)
    return Container("box", T, (float(inner[0]), float(inner[1]), float(height)), wall, floor)


def _find_rim(view: TopView, region: Region, pitch: float) -> _Rim | None:
    """Level ring -> its smallest rectangle -> edges refined on profiles across each side."""
    shape = np.ceil((region.high - region.low)[1::-1] / pitch).astype(int)
    T_world_map = geometry.pose(np.eye(3), np.append(region.low[:2], region.plane_z))
    top = view.heights(T_world_map, pitch, (int(shape[0]), int(shape[1])))
    ring, height = _level_ring(top, region.lowest)
    if np.count_nonzero(ring) < 20 or height < _MIN_HEIGHT:
        return None
    rows, cols = np.nonzero(ring)
    cells = np.stack([cols + 0.5, rows + 0.5], axis=1) * pitch + region.low[:2]
    (x, y), (width, length), degrees = cv2.minAreaRect(cells.astype(np.float32))
    T = _upright(x, y, region.plane_z, np.deg2rad(degrees))
    outer = np.array([width, length]) + pitch
    for _ in range(3):
        T, outer, rim = _refine(view, T, outer, height)
        if rim is None:
            return None
    return rim


def _level_ring(top: HeightMap, lowest: float) -> tuple[np.ndarray, float]:
    """(rows, cols) bool of the cells level with the outer edge of the blob, and that height."""
    blob = np.nan_to_num(top.heights, nan=0.0) > lowest
    names, count = ndimage.label(ndimage.binary_closing(blob, iterations=2))
    if not count:
        return blob, 0.0
    blob &= names == np.argmax(np.bincount(names.ravel())[1:]) + 1
    filled = ndimage.binary_fill_holes(ndimage.binary_closing(blob, iterations=2))
    outline = filled & ~ndimage.binary_erosion(filled)
    # A wall may be one cell wide: what counts is the highest thing next to the outline.
    heights = np.where(blob, top.heights, 0)
    highest = ndimage.maximum_filter(heights, size=2 * int(np.ceil(_BAND / top.pitch)) + 1)
    level = np.round(highest[outline] / 0.001).astype(int)
    votes = np.convolve(np.bincount(level), np.ones(3), mode="same")
    near = blob & (np.abs(heights - np.argmax(votes) * 0.001) < _LEVEL)
    height = float(np.median(heights[near])) if near.any() else 0.0
    return blob & (np.abs(heights - height) < _LEVEL), height


def _refine(view: TopView, T: np.ndarray, outer: np.ndarray, height: float
            ) -> tuple[np.ndarray, np.ndarray, _Rim | None]:
    """Edges of the four sides from profiles; the frame follows their offsets and slopes."""
    edges, walls, slopes, rims, drops = [], [], [], [], []
    for side in range(4):
        profile = _profiles(view, T, outer, side, height)
        along, out, drop = profile
        # A rim is straight: only profiles that agree on where it is count as seeing it.
        edge = float(np.nanmedian(out)) if np.isfinite(out).any() else np.nan
        near = np.abs(out - edge) < _STRAIGHT
        if np.count_nonzero(near) < 8:
            return T, outer, None
        slopes.append(np.polyfit(along[near], out[near], 1)[0])
        edges.append(edge)
        wall = float(np.nanmedian(drop)) - edge if np.isfinite(drop).any() else np.nan
        agree = np.abs(drop - edge - wall) < _STRAIGHT
        walls.append(wall if np.count_nonzero(agree) >= 8 else np.nan)
        rims.append(near.mean())
        drops.append((near & agree).mean())
    # Turning the frame by a small angle slopes every side alike (see _profiles for the signs).
    shift = np.array([edges[0] - edges[1], edges[2] - edges[3]]) / 2
    outer = outer - [edges[0] + edges[1], edges[2] + edges[3]]
    T = T @ _upright(shift[0], shift[1], 0, float(np.median(slopes)))
    return T, outer, _Rim(T, outer, height, np.array(walls), float(np.mean(rims)),
                          float(np.mean(drops)))


def _profiles(view: TopView, T: np.ndarray, outer: np.ndarray, side: int, height: float
              ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Heights on lines across one side, from outside inwards.

    Returns:
        For every profile its position along the side, and, as distance inwards from the first
        guess of the side, the outer edge of the rim and the drop inside it; NaN where not seen.
        Positions run so that a positive slope means a positive turn of the frame for every side.
    """
    turn = (np.pi, 0.0, -np.pi / 2, np.pi / 2)[side]  # outward normal: -x, +x, -y, +y
    across, along = (outer[0], outer[1]) if side < 2 else (outer[1], outer[0])
    reach = min(max(_REACH, 0.12 * across), across / 2 - _STEP)
    # The strip's frame: x inwards across the side, y along it.
    corner = geometry.pose(np.diag([-1.0, -1, 1]), np.array([across / 2 + _REACH, 0.4 * along, 0]))
    strip = T @ _upright(0, 0, 0, turn) @ corner
    lines = int(0.8 * along / _STEP)
    heights = view.heights(strip, _STEP, (lines, int((_REACH + reach) / _STEP))).heights[::4]
    high = heights > height - _LEVEL
    level = high & (heights < height + _LEVEL)
    first = np.argmax(high, axis=1)
    rows = np.arange(len(first))
    out = np.where(level[rows, first], first * _STEP - _REACH, np.nan)
    positions = np.arange(heights.shape[1])
    low_after = (heights < height - _LEVEL) & (positions > first[:, None])
    # Parts above the rim hide the drop; a profile counts only if the ring stays level up to it.
    drop_at = np.argmax(low_after, axis=1)
    stays = np.array([np.all(level[r, first[r]:drop_at[r]]) for r in rows])
    drop = np.where(np.any(low_after, axis=1) & stays & np.isfinite(out),
                    drop_at * _STEP - _REACH, np.nan)
    return (rows * 4 + 0.5) * _STEP - 0.4 * along, out, drop
