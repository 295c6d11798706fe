# SPDX-License-Identifier: Apache-2.0
"""A container's inner surface as its CAD file shows it: heights, outlines, and the file of it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy import ndimage

from stack_counter.container.construction import SETTINGS as CONSTRUCTION_SETTINGS
from stack_counter.errors import ConfigError
from stack_counter.images import decode_image
from stack_counter.types import Container, InnerMap


@dataclass(frozen=True)
class InnerMapSettings:
    """How finely outlines are read from a map, and how its file holds heights; all chosen.

    Attributes:
        directions: corners of an outline, one for each degree.
        level_margin: distance that an outline keeps from the level floor and from the level rim,
            m, at which it would be undefined.
        height_unit: height of one step of the file's 16 bits, m; the tallest is 1.3 m.
    """

    directions: int = 360
    level_margin: float = 0.0005
    height_unit: float = 0.00002


SETTINGS = InnerMapSettings()


def sample_heights(inner: InnerMap, xy: np.ndarray) -> np.ndarray:
    """Heights of the cells in which points lie.

    Args:
        inner: map of the inner surface.
        xy: (..., 2) metres, container frame.

    Returns:
        (...) float32 metres above the support plane; NaN outside the opening.
    """
    rows, cols = inner.heights.shape
    col, row = np.moveaxis(np.floor(xy / inner.pitch + np.array([cols, rows]) / 2).astype(int),
                           -1, 0)
    within = (col >= 0) & (col < cols) & (row >= 0) & (row < rows)
    heights = inner.heights[np.where(within, row, 0), np.where(within, col, 0)]
    return np.where(within, heights, np.float32(np.nan))


def grown_upwards(inner: InnerMap, margin: float) -> InnerMap:
    """The map in which each cell is as high as the highest within a distance, metres.

    What lies so near a wall or a ledge cannot be told from it. Beyond the opening is wall.
    """
    cells = 2 * int(np.ceil(margin / inner.pitch)) + 1
    walls = np.where(np.isnan(inner.heights), np.float32(np.inf), inner.heights)
    return replace(inner, heights=ndimage.maximum_filter(walls, cells, mode="constant",
                                                         cval=np.inf))


def grown_downwards(inner: InnerMap, margin: float) -> InnerMap:
    """The map in which each cell is as low as the lowest within a distance, metres.

    What lies so near a wall or a ledge may be beside it. Beyond the opening nothing is known.
    """
    cells = 2 * int(np.ceil(margin / inner.pitch)) + 1
    outside = np.isnan(inner.heights)
    lowest = ndimage.minimum_filter(np.where(outside, np.float32(np.inf), inner.heights), cells)
    return replace(inner, heights=np.where(outside, np.float32(np.nan), lowest))


def with_inner_map(container: Container, inner: InnerMap, rim: float) -> Container:
    """The container with the inner surface of its CAD file, and the outlines of that.

    Args:
        container: of which pose, wall and floor stay.
        inner: map of its inner surface.
        rim: height of its rim by the CAD file above its underside, metres.
    """
    levels = np.linspace(0, rim, CONSTRUCTION_SETTINGS.levels)
    rings = trace_outlines(inner, levels, container.floor_thickness_m, rim)
    x, y = np.ptp(rings[-1, :, :2], axis=0)
    return replace(container, inner_map=inner, rings=rings,
                   inner_size_m=(float(x), float(y), rim - container.floor_thickness_m))


def trace_outlines(inner: InnerMap, levels: np.ndarray, floor: float, rim: float) -> np.ndarray:
    """Outlines of the inner wall: how far from the middle the surface still lies below a level.

    Args:
        inner: map of the inner surface.
        levels: (k,) heights above the support plane, metres.
        floor: height of the level floor, metres; lower outlines are as there.
        rim: height of the rim, metres.

    Returns:
        (k, n, 3) counter-clockwise, container frame, metres.
    """
    s = SETTINGS
    # Heights along rays from the middle, at every half cell.
    angle = 2 * np.pi * np.arange(s.directions) / s.directions - np.pi
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    step = inner.pitch / 2
    reach = np.arange(int(np.hypot(*inner.heights.shape))) * step
    along = sample_heights(inner, reach[:, None, None] * direction)  # (r, n)
    # The outermost step on each ray that is below the level; the wall stands half a step on.
    rings = []
    for level in levels:
        below = along < np.clip(level, floor + s.level_margin, rim - s.level_margin)
        last = len(reach) - 1 - np.argmax(below[::-1], axis=0)
        radius = np.where(below.any(axis=0), reach[last], 0.0) + step / 2
        rings.append(np.column_stack([radius[:, None] * direction,
                                      np.full(s.directions, level)]))
    return np.stack(rings)


def write_inner_map(path: Path, inner: InnerMap) -> None:
    """Writes the heights as a 16-bit PNG that any viewer shows; 0 is outside the opening.

    Raises:
        OSError: the file cannot be written.
    """
    steps = np.round(np.nan_to_num(inner.heights) / SETTINGS.height_unit)
    steps = np.where(np.isnan(inner.heights), 0, np.clip(steps, 1, 0xFFFF)).astype(np.uint16)
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(cv2.imencode(".png", steps)[1].tobytes())
    unfinished.replace(path)


def read_inner_map(path: Path, pitch: float) -> InnerMap:
    """Reads what `write_inner_map` wrote.

    Args:
        path: of the PNG.
        pitch: side of a cell, metres.

    Raises:
        ConfigError: the file is missing, or is no such picture.
    """
    try:
        content = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"no inner surface {path}: {error.strerror}; expected the file that "
                          "`stack-counter container teach NAME --mesh FILE` wrote") from error
    steps = decode_image(content, cv2.IMREAD_UNCHANGED)
    if steps is None or steps.dtype != np.uint16 or steps.ndim != 2 or not steps.any():
        raise ConfigError(f"{path} is no inner surface; expected the 16-bit grey PNG that "
                          "`stack-counter container teach NAME --mesh FILE` wrote")
    heights = np.where(steps == 0, np.nan, steps * SETTINGS.height_unit)
    return InnerMap(pitch, heights.astype(np.float32))
