# SPDX-License-Identifier: Apache-2.0
"""Tells an open container from a closed one, in a stack that was carved as if it were closed.

No rim was found, so wall and floor count as parts. Where the container is open, views that look
into it carve the space above its parts, and what is left is a ring around a basin. If it is full
there is none, but its sides show no parts, as those of a clear bag do.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage

from stack_counter import geometry
from stack_counter.segmentation.labels import require_labels
from stack_counter.types import CONTAINER, PARTS, HeightMap, View


@dataclass(frozen=True)
class BasinSettings:
    """What is a basin; all chosen.

    Attributes:
        levels: number of heights at which water may stand.
        min_share: least volume of the basin, over that of what is carved: a bag has dents.
        min_area_share: least area of the basin, over that of what is carved.
        rim_step: levels by which a rim may be uneven.
        foot_share: height of a stack's foot, over the stack's.
        facing: least cosine, seen from above, between the ways from the stack's middle to a place
            of its foot and to the camera that sees it.
        min_foot_parts: least share of parts in what the foot of a clear bag shows: 0.77 of a real
            bag of noodles; at most 0.30 of five cans and a bin of training scenes, all of which
            were steep views on the parts in them.
    """

    levels: int = 64
    min_share: float = 0.08
    min_area_share: float = 0.25
    rim_step: int = 2
    foot_share: float = 0.3
    facing: float = 0.7
    min_foot_parts: float = 0.4


SETTINGS = BasinSettings()


@dataclass(frozen=True, eq=False)
class Basin:
    """The inside of an open container, as far as its rim holds water.

    Attributes:
        cells: (rows, cols) bool, the cells inside the rim.
        rim_height: of the water, metres above the map's plane.
        wall_m: mean thickness of the ring around it, metres.
    """

    cells: np.ndarray
    rim_height: float
    wall_m: float


def find_basin(top: HeightMap) -> Basin | None:
    """Finds the largest basin of a carved stack; None where it is closed.

    Args:
        top: highest surface above the support plane, NaN where nothing stands.
    """
    heights = np.nan_to_num(top.heights, nan=0.0)
    stands = heights > 0
    if not stands.any():
        return None
    # Pour water up to each level: it stays where the ring of what is higher is closed.
    levels = np.linspace(0, float(heights.max()), SETTINGS.levels + 1)[1:]
    volumes, waters = [], []
    for level in levels:
        higher = heights >= level
        water = ndimage.binary_fill_holes(higher) & ~higher
        labels, count = ndimage.label(water)
        if count:
            water = labels == np.argmax(np.bincount(labels.ravel())[1:]) + 1
        waters.append(water)
        volumes.append(float((level - heights)[water].sum()))
    # The rim is as high as the level that holds the most.
    best = int(np.argmax(volumes))
    cells, level = waters[best], levels[max(best - SETTINGS.rim_step, 0)]
    if volumes[best] < SETTINGS.min_share * heights.sum() \
            or np.count_nonzero(cells) < SETTINGS.min_area_share * np.count_nonzero(stands):
        return None
    # The ring's area over its length is the wall's thickness.
    around = ndimage.binary_dilation(cells) & ~cells
    ring = (heights >= level) & ~cells
    length = np.count_nonzero(around) * top.pitch
    return Basin(cells, float(levels[best]),
                 float(np.count_nonzero(ring) * top.pitch**2 / length))


@dataclass(frozen=True, eq=False)
class BasinFill:
    """What lies in a container.

    Attributes:
        top, inner: highest surface and floor; NaN where nothing of the container's inside is.
        volume, volume_std: between them, m3.
    """

    top: HeightMap
    inner: HeightMap
    volume: float
    volume_std: float


def measure_basin(basin: Basin, top: HeightMap, surface_std: float) -> BasinFill:
    """Measures what lies in a basin, whose floor is taken to be as thick as its wall.

    Args:
        basin: of the carved stack.
        top: highest surface of that.
        surface_std: standard deviation of the volume of all that was carved, m3.
    """
    floor = np.where(basin.cells, basin.wall_m, np.nan).astype(np.float32)
    heights = np.where(basin.cells, np.fmax(top.heights, basin.wall_m), np.nan)
    area = np.count_nonzero(basin.cells) * top.pitch**2
    volume = float(np.nansum(heights - floor)) * top.pitch**2
    return BasinFill(replace(top, heights=heights.astype(np.float32)),
                     replace(top, heights=floor), volume,
                     float(np.hypot(surface_std, basin.wall_m * area)))


def sides_show_parts(views: list[View], surface: np.ndarray) -> bool:
    """Whether parts show through the foot of a stack, where an open container shows its wall.

    Args:
        views: with labels; z of the world is up.
        surface: (n, 3) of the carved stack, metres, world.

    Raises:
        ViewError: reason `no_labels`, if a view lacks them.
    """
    heights, middle = surface[:, 2], surface[:, :2].mean(axis=0)
    foot = surface[heights <= heights.min() + SETTINGS.foot_share * np.ptp(heights)]
    outwards = _directions(foot[:, :2] - middle)
    # Count the labels of each side in the views that look at it.
    parts = shown = 0
    for view in views:
        faces = outwards @ _directions(view.T_world_camera[:2, 3] - middle) > SETTINGS.facing
        at = geometry.project_into(view, foot[faces])
        labels = require_labels(view)[at.rows, at.cols]
        parts += int(np.count_nonzero(labels == PARTS))
        shown += int(np.count_nonzero(np.isin(labels, (CONTAINER, PARTS))))
    return parts > SETTINGS.min_foot_parts * shown


def _directions(vectors: np.ndarray) -> np.ndarray:
    """(..., 2) vectors of length 1."""
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)
