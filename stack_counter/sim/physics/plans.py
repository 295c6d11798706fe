# SPDX-License-Identifier: Apache-2.0
"""What to simulate: a random container, number of parts and surface for a part."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass

import numpy as np
from scipy.integrate import trapezoid

from stack_counter.sim.physics.container_draws import (
    draw_container,
    draw_deep_container,
    draw_deep_size,
    draw_kind,
    draw_shallow_size,
    expected_gamma,
    log_uniform,
    place_container,
)
from stack_counter.sim.scenes.containers import ROUND_KINDS, ContainerShape, polygon_area
from stack_counter.sim.shapes import Shape

# Kinds of containers and their shares: in the two halves of the training distribution.
_SHALLOW_KINDS = {"bin": 0.42, "cylinder": 0.1, "bowl": 0.08, "cup": 0.07, "tray": 0.1,
                  "bag": 0.06, "none": 0.17}
_DEEP_KINDS = {"bin": 0.48, "cylinder": 0.14, "bowl": 0.09, "cup": 0.09, "bag": 0.08,
               "none": 0.12}


@dataclass(frozen=True)
class PlanSettings:
    """The distribution that piles are drawn from; chosen.

    Attributes:
        min_parts, max_parts: fewest and most parts of a scene.
        friction: range of the friction of parts on each other and on the container, whose
            logarithm is uniform. It stands in for the jolts of pouring too. At 0.6 balls and
            regular dice lie as loose as they can (gamma 0.49 to 0.56, measured 0.50 to 0.55), at
            0.05 as dense as shaken ones (0.62 to 0.64, measured 0.59 to 0.64; cubes denser);
            poured balls (0.58 to 0.60) are at 0.15 to 0.2. Measured: Baker & Kudrolli, "Maximum
            and minimum stable random packings of Platonic solids" (2010).
        deep_share: share of deep scenes in a mixed set.
        fill, rig_fill: ranges of the stack's height over the container's depth.
        restitution: range of all contacts.
        shaken_share: share of the piles that are shaken; fewer taps than 20 change nothing.
        taps: fewest and most of a pile that is shaken.
        heap_parts: fewest and most parts of a heap.
        heap_slope_deg: slope of a heap that just lies within its region.
        min_heap_radius: least radius of a heap's region, in part sizes.
        heap_column: range of the poured column's side over the radius of the region.
        column_share, round_column_share: side of the poured column over the container's.
    """

    min_parts: int = 12
    max_parts: int = 1000
    friction: tuple[float, float] = (0.05, 0.6)
    deep_share: float = 2 / 3
    fill: tuple[float, float] = (0.06, 1.15)
    rig_fill: tuple[float, float] = (0.15, 1.1)
    restitution: tuple[float, float] = (0, 0.3)
    shaken_share: float = 0.1
    taps: tuple[int, int] = (20, 60)
    heap_parts: tuple[int, int] = (20, 700)
    heap_slope_deg: float = 15
    min_heap_radius: float = 2.5
    heap_column: tuple[float, float] = (0.5, 1.2)
    column_share: float = 0.95
    round_column_share: float = 0.7


@dataclass(frozen=True)
class BoxPlanSettings:
    """Scenes like those of the paper's test set.

    Source: paper, section 4 and supplement, "Simulation". The friction is that of `PlanSettings`
    and not the paper's 0.3 to 0.6, at which piles stand looser than poured things do.

    Attributes:
        width: range of the smaller side, in part sizes.
        length, depth, wall: ranges over the width.
        fill: range of the stack's height over the depth.
        parts: fewest and most.
        restitution: range of all contacts.
    """

    width: tuple[float, float] = (4, 6.5)
    length: tuple[float, float] = (1, 1.3)
    depth: tuple[float, float] = (0.7, 1)
    wall: tuple[float, float] = (0.01, 0.05)
    fill: tuple[float, float] = (0.4, 1.1)
    parts: tuple[int, int] = (20, 700)
    restitution: tuple[float, float] = (0, 0.3)


SETTINGS = PlanSettings()
BOX_SETTINGS = BoxPlanSettings()
FRICTION = SETTINGS.friction


@dataclass(frozen=True, eq=False)
class PilePlan:
    """What to drop where; metres.

    Attributes:
        shape: the part.
        container: the container, or the region of a heap.
        column_m: (2,) sides of the column that the parts fall through.
        count: number of parts dropped.
        friction, restitution: coefficients of all contacts.
        taps: number of times that the container is shaken when it is filled.
    """

    shape: Shape
    container: ContainerShape
    column_m: np.ndarray
    count: int
    friction: float = 0.4
    restitution: float = 0.1
    taps: int = 0


@dataclass(frozen=True)
class Handling:
    """What is drawn of a pile besides its place; the fields of `PilePlan`."""

    friction: float
    restitution: float
    taps: int


def draw_mixed_plan(random: np.random.Generator, shape: Shape, max_parts: int) -> PilePlan:
    """Draws any container and any fill: deep in two of three scenes."""
    deep = random.random() < SETTINGS.deep_share
    return (draw_deep_plan if deep else draw_shallow_plan)(random, shape, max_parts)


def draw_shallow_plan(random: np.random.Generator, shape: Shape, max_parts: int) -> PilePlan:
    """Draws any width alike, and therefore low stacks where the parts are many."""
    return _draw_plan(random, shape, max_parts, _SHALLOW_KINDS, draw_shallow_size)


def draw_deep_plan(random: np.random.Generator, shape: Shape, max_parts: int) -> PilePlan:
    """Draws containers about as deep as wide, and therefore narrow ones for thin parts."""
    return _draw_plan(random, shape, max_parts, _DEEP_KINDS, draw_deep_size)


def draw_rig_plan(random: np.random.Generator, rig_random: np.random.Generator, shape: Shape,
                  max_parts: int) -> PilePlan:
    """Draws one pile of a cell in which the container and the friction stay as they are.

    `rig_random` draws those, `random` the rest.
    """
    container = draw_deep_container(rig_random, shape, max_parts)
    friction = log_uniform(rig_random, FRICTION)
    return draw_plan_in_container(random, shape, container, (friction, friction), max_parts)


def draw_plan_in_container(random: np.random.Generator, shape: Shape, container: ContainerShape,
                           friction: tuple[float, float], max_parts: int) -> PilePlan:
    """Draws any fill of a given container, the friction between two bounds."""
    return _draw_fill(random, shape, container, max_parts, SETTINGS.rig_fill,
                      _draw_handling(random, friction))


def plan_pour(random: np.random.Generator, shape: Shape, container: ContainerShape,
              friction: tuple[float, float], count: int) -> PilePlan:
    """Draws how so many parts are poured into a given container."""
    return PilePlan(shape, container, _pour_column(container), count,
                    **asdict(_draw_handling(random, friction)))


def draw_box_plan(random: np.random.Generator, shape: Shape, max_parts: int) -> PilePlan:
    """Draws one scene like those of the paper's test set.

    A box about five parts wide, part to heaped full.
    """
    box = BOX_SETTINGS
    width = random.uniform(*box.width) * shape.part_size
    size = (width, width * random.uniform(*box.length), width * random.uniform(*box.depth))
    container = place_container(random, "bin", size, width * random.uniform(*box.wall), 0.0)
    count = _count_when_full(container, shape) * random.uniform(*box.fill)
    fewest, most = box.parts
    return PilePlan(shape, container, _pour_column(container),
                    int(np.clip(count, fewest, min(max_parts, most))),
                    log_uniform(random, FRICTION), random.uniform(*box.restitution))


def _draw_plan(random: np.random.Generator, shape: Shape, max_parts: int,
               kind_shares: dict[str, float], draw_size: Callable[..., np.ndarray]) -> PilePlan:
    """Draws a container whose inner size (3,) `draw_size` gives, or a heap, and its fill."""
    kind = draw_kind(random, kind_shares)
    handling = _draw_handling(random, FRICTION)
    if kind == "none":
        return _draw_heap(random, shape, max_parts, handling)
    container = draw_container(random, shape, kind, draw_size(random, shape, kind, max_parts))
    return _draw_fill(random, shape, container, max_parts, SETTINGS.fill, handling)


def _draw_handling(random: np.random.Generator, friction: tuple[float, float]) -> Handling:
    """Draws friction between two bounds, restitution, and taps of some piles."""
    fewest, most = SETTINGS.taps
    return Handling(
        friction=log_uniform(random, friction), restitution=random.uniform(*SETTINGS.restitution),
        taps=int(random.integers(fewest, most + 1)) if random.random() < SETTINGS.shaken_share
        else 0)


def _draw_fill(random: np.random.Generator, shape: Shape, container: ContainerShape,
               max_parts: int, fill: tuple[float, float], handling: Handling) -> PilePlan:
    """Draws a number of parts that fill a share of the container between two bounds."""
    count = _count_when_full(container, shape) * random.uniform(*fill)
    return PilePlan(shape, container, _pour_column(container),
                    int(np.clip(count, SETTINGS.min_parts, max_parts)), **asdict(handling))


def _count_when_full(container: ContainerShape, shape: Shape) -> float:
    """Number of parts that the container may hold, level with the rim."""
    rings = container.inner_rings
    volume = trapezoid(polygon_area(rings[..., :2]), rings[:, 0, 2])
    return float(volume) * expected_gamma(shape) / shape.unit_volume


def _pour_column(container: ContainerShape) -> np.ndarray:
    """(2,) sides of the column that parts fall through, metres.

    Of a round container about the square in its circle.
    """
    share = SETTINGS.round_column_share if container.kind in ROUND_KINDS \
        else SETTINGS.column_share
    return np.array(container.inner_size_m[:2]) * share


def _draw_heap(random: np.random.Generator, shape: Shape, max_parts: int, handling: Handling
               ) -> PilePlan:
    """Draws a heap poured through a column.

    What lies farther out than a heap of a gentle slope would reach is no part of it.
    """
    fewest, most = SETTINGS.heap_parts
    count = int(log_uniform(random, (fewest, min(max_parts, most))))
    # A cone of that slope and volume
    volume = count * shape.unit_volume / expected_gamma(shape)
    slope = np.tan(np.deg2rad(SETTINGS.heap_slope_deg))
    radius = max((3 * volume / (np.pi * slope)) ** (1 / 3),
                 SETTINGS.min_heap_radius * shape.part_size)
    region = place_container(random, "none", (2 * radius, 2 * radius, 0.0), 0.0, 0.0)
    side = random.uniform(*SETTINGS.heap_column) * radius
    return PilePlan(shape, region, np.array([side, side]), count, **asdict(handling))
