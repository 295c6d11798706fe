# SPDX-License-Identifier: Apache-2.0
"""Random containers for a part: sizes, walls and place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ROUND_KINDS, ContainerShape
from stack_counter.sim.shapes import Shape

# Kinds of containers of a rig and their shares.
_RIG_KINDS = {"bin": 0.6, "cylinder": 0.15, "bowl": 0.1, "cup": 0.15}



@dataclass(frozen=True)
class ContainerDrawSettings:
    """The distribution that containers are drawn from; chosen.

    Attributes:
        width: range of the smaller inner side, in part sizes.
        capacity: range of the number of parts that the full container holds.
        min_depth: depth of the lowest container, in part sizes.
        square_share: share of containers with equal sides, of those that are not round.
        max_aspect: longest side over the smaller one.
        shallow_depth, deep_depth: ranges of the depth over the width by kind, "" for the others.
        tray_depth: range of a shallow tray's depth, in part sizes.
        wall: range of the wall's thickness over the width.
        floor: range of the floor's thickness over the wall's.
        drafted_share: share of bins and trays whose walls are inclined.
        draft_deg: range of the inclination.
        max_draft_slope: most that a wall may lean in over the depth, in widths.
        offset_m: range of the container's place along world x and y.
        loosest_gamma, gamma_exponent: gamma of a convex part, and by which power of the part's
            convexity gamma falls, where a size is chosen for a number of parts.
    """

    width: tuple[float, float] = (4.0, 20.0)
    capacity: tuple[float, float] = (60.0, 1000.0)
    min_depth: float = 0.5
    square_share: float = 0.4
    max_aspect: float = 1.8
    shallow_depth: Mapping[str, tuple[float, float]] = field(default_factory=lambda: {
        "bowl": (0.3, 0.5), "cup": (0.8, 1.5), "": (0.3, 1.1)})
    deep_depth: Mapping[str, tuple[float, float]] = field(default_factory=lambda: {
        "bowl": (0.3, 0.5), "cup": (0.8, 1.5), "": (0.4, 1.2)})
    tray_depth: tuple[float, float] = (0.4, 1.5)
    wall: tuple[float, float] = (0.005, 0.08)
    floor: tuple[float, float] = (0.8, 1.2)
    drafted_share: float = 0.5
    draft_deg: tuple[float, float] = (1, 12)
    max_draft_slope: float = 0.15
    offset_m: tuple[float, float] = (-0.05, 0.05)
    loosest_gamma: float = 0.58
    gamma_exponent: float = 0.6


SETTINGS = ContainerDrawSettings()


def expected_gamma(part_shape: Shape) -> float:
    """Estimates gamma, for choosing a number of parts: concave parts are looser."""
    return SETTINGS.loosest_gamma * part_shape.convexity**SETTINGS.gamma_exponent


def draw_deep_container(random: np.random.Generator, shape: Shape, max_parts: int
                        ) -> ContainerShape:
    """Draws a container about as deep as wide, as a cell may have it."""
    kind = draw_kind(random, _RIG_KINDS)
    return draw_container(random, shape, kind, draw_deep_size(random, shape, kind, max_parts))


def draw_kind(random: np.random.Generator, shares: dict[str, float]) -> str:
    """Draws a kind of container by the shares of all kinds."""
    return str(random.choice(list(shares), p=list(shares.values())))


def draw_shallow_size(random: np.random.Generator, shape: Shape, kind: str, max_parts: int
                       ) -> np.ndarray:
    """Draws an inner size (3,) in part sizes.

    A width, and the depth for which a full one holds a drawn number of parts, so that the fill
    drawn later does not depend on the width.
    """
    width = log_uniform(random, SETTINGS.width)
    length = width * _draw_aspect(random, kind)
    capacity = min(log_uniform(random, SETTINGS.capacity), max_parts)
    volume = capacity * _volume_per_part(shape)
    low, high = SETTINGS.shallow_depth.get(kind, SETTINGS.shallow_depth[""])
    depth = random.uniform(*SETTINGS.tray_depth) if kind == "tray" \
        else random.uniform(low * width, high * width)
    # Too deep for so many parts: lower
    if depth * width * length / _volume_per_part(shape) > capacity:
        depth = volume / (width * length)
    # Not one layer of so many parts: smaller
    if depth < SETTINGS.min_depth:
        width, length = np.array([width, length]) * np.sqrt(depth / SETTINGS.min_depth)
        least = SETTINGS.width[0]
        width, length, depth = max(width, least), max(length, least), SETTINGS.min_depth
    return np.array([width, length, depth])


def draw_deep_size(random: np.random.Generator, shape: Shape, kind: str, max_parts: int
                    ) -> np.ndarray:
    """Draws an inner size (3,) in part sizes.

    Proportions, and the width for which a full one holds a drawn number of parts; of parts so thin
    that the least width is too wide for that, a lower one.
    """
    aspect = _draw_aspect(random, kind)
    proportions = SETTINGS.deep_depth.get(kind, SETTINGS.deep_depth[""])
    depth_over_width = random.uniform(*proportions)
    volume = min(log_uniform(random, SETTINGS.capacity), max_parts) * _volume_per_part(shape)
    width = float(np.clip((volume / (depth_over_width * aspect)) ** (1 / 3), *SETTINGS.width))
    depth = max(min(depth_over_width * width, volume / (width**2 * aspect)), SETTINGS.min_depth)
    return np.array([width, aspect * width, depth])


def _draw_aspect(random: np.random.Generator, kind: str) -> float:
    """Length over width; 1 for round containers."""
    square = kind in ROUND_KINDS or random.random() < SETTINGS.square_share
    return 1.0 if square else random.uniform(1, SETTINGS.max_aspect)


def log_uniform(random: np.random.Generator, limits: tuple[float, float]) -> float:
    """Draws a number whose logarithm is uniform between those of two limits."""
    return np.exp(random.uniform(*np.log(limits)))


def _volume_per_part(shape: Shape) -> float:
    """Room that one part takes in a pile, in cubes of the part size."""
    return shape.unit_volume / shape.part_size**3 / expected_gamma(shape)


def draw_container(random: np.random.Generator, shape: Shape, kind: str, inner_size: np.ndarray
                    ) -> ContainerShape:
    """Draws walls and place of a container of an inner size (3,) in part sizes."""
    width, _, depth = inner_size
    size = inner_size * shape.part_size
    draft = 0.0
    if kind == "cup" or (kind in ("bin", "tray") and random.random() < SETTINGS.drafted_share):
        draft = min(np.deg2rad(random.uniform(*SETTINGS.draft_deg)),
                    np.arctan(SETTINGS.max_draft_slope * width / depth))
    wall = width * shape.part_size * random.uniform(*SETTINGS.wall)
    return place_container(random, kind, (size[0], size[1], size[2]), wall, draft)


def place_container(random: np.random.Generator, kind: str, size_m: tuple[float, float, float],
                    wall_m: float, draft_rad: float) -> ContainerShape:
    """Turns and moves a container at random about the world's origin."""
    yaw = random.uniform(-np.pi, np.pi)
    c, s = np.cos(yaw), np.sin(yaw)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
                      np.array([*random.uniform(*SETTINGS.offset_m, 2), 0.0]))
    return ContainerShape(kind, T, size_m, wall_m, wall_m * random.uniform(*SETTINGS.floor),
                          draft_rad, int(random.integers(2**31)))
