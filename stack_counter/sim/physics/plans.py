"""What to simulate: a random part, container, number of parts and surface."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ROUND_KINDS, ContainerShape
from stack_counter.sim.shapes import Shape

MIN_PARTS, MAX_PARTS = 12, 1000
# Kinds of containers and their shares in the two halves of the training distribution.
_SHALLOW = {"bin": 0.42, "cylinder": 0.1, "bowl": 0.08, "cup": 0.07, "tray": 0.1, "bag": 0.06,
            "none": 0.17}
_DEEP = {"bin": 0.48, "cylinder": 0.14, "bowl": 0.09, "cup": 0.09, "bag": 0.08, "none": 0.12}
_RIG = {"bin": 0.6, "cylinder": 0.15, "bowl": 0.1, "cup": 0.15}
_DEEP_SHARE = 2 / 3  # of deep scenes in a mixed set
_WIDTH = (4.0, 20.0)  # smaller inner side, in part sizes
_CAPACITY = (60.0, 1000.0)  # parts that the full container holds
_FILL = (0.06, 1.15)  # of the depth
_RIG_FILL = (0.15, 1.1)
FRICTION = (0.2, 0.7)  # of dry parts on each other and on the container
_SHAKEN = 0.25  # share of piles that are shaken
_LOWEST = 0.5  # depth of the lowest container, in part sizes


@dataclass(frozen=True)
class PilePlan:
    """What to drop where; metres.

    Attributes:
        column_m: (2,) sides of the column that the parts fall through.
        count: parts dropped.
        friction, restitution: of all contacts.
        taps: how often the container is shaken when it is filled.
    """

    shape: Shape
    container: ContainerShape
    column_m: np.ndarray
    count: int
    friction: float = 0.4
    restitution: float = 0.1
    taps: int = 0


def expected_gamma(shape: Shape) -> float:
    """gamma to expect, for choosing a number of parts: concave parts are looser."""
    return 0.58 * shape.convexity**0.6


def draw_mixed_plan(random: np.random.Generator, shape: Shape, most: int) -> PilePlan:
    """Any container, any fill: deep in two of three scenes."""
    deep = random.random() < _DEEP_SHARE
    return (draw_deep_plan if deep else draw_shallow_plan)(random, shape, most)


def draw_shallow_plan(random: np.random.Generator, shape: Shape, most: int) -> PilePlan:
    """Any width alike, and therefore low stacks where the parts are many: from one layer up."""
    return _plan(random, shape, most, _SHALLOW, _shallow_size)


def draw_deep_plan(random: np.random.Generator, shape: Shape, most: int) -> PilePlan:
    """Containers about as deep as wide, and therefore narrow ones for thin parts."""
    return _plan(random, shape, most, _DEEP, _deep_size)


def _plan(random: np.random.Generator, shape: Shape, most: int, shares: dict[str, float],
          size_of: Callable[..., np.ndarray]) -> PilePlan:
    kind = _one_of(random, shares)
    surface = _surface(random, FRICTION)
    if kind == "none":
        return _heap(random, shape, most, surface)
    container = _container(random, shape, kind, size_of(random, shape, kind, most))
    return _filled(random, shape, container, most, _FILL, surface)


def draw_rig_plan(random: np.random.Generator, rig: np.random.Generator, shape: Shape, most: int
             ) -> PilePlan:
    """One pile of a cell in which the container and the friction stay as they are; `rig` draws
    those, `random` the rest."""
    container = draw_deep_container(rig, shape, most)
    friction = rig.uniform(*FRICTION)
    return draw_plan_in_container(random, shape, container, (friction, friction), most)


def draw_plan_in_container(random: np.random.Generator, shape: Shape, container: ContainerShape,
                           friction: tuple[float, float], most: int) -> PilePlan:
    """Any fill of a given container, the friction between two bounds."""
    return _filled(random, shape, container, most, _RIG_FILL, _surface(random, friction))


def draw_deep_container(random: np.random.Generator, shape: Shape, most: int) -> ContainerShape:
    """A container about as deep as wide, as a cell may have it."""
    kind = _one_of(random, _RIG)
    return _container(random, shape, kind, _deep_size(random, shape, kind, most))


def _one_of(random: np.random.Generator, shares: dict[str, float]) -> str:
    return str(random.choice(list(shares), p=list(shares.values())))


def _surface(random: np.random.Generator, friction: tuple[float, float]) -> dict:
    return {"friction": random.uniform(*friction), "restitution": random.uniform(0, 0.3),
            "taps": int(random.integers(3, 7)) if random.random() < _SHAKEN else 0}


def _filled(random: np.random.Generator, shape: Shape, container: ContainerShape, most: int,
            fill: tuple[float, float], surface: dict) -> PilePlan:
    count = _capacity(container, shape) * random.uniform(*fill)
    return PilePlan(shape, container, _column(container), int(np.clip(count, MIN_PARTS, most)),
                    **surface)


def draw_box_plan(random: np.random.Generator, shape: Shape, most: int) -> PilePlan:
    """One scene like those of the paper's test set: a box about five parts wide, part to
    heaped full. Source: paper, section 4 and supplement, "Simulation"."""
    width = random.uniform(4, 6.5) * shape.part_size
    size = (width, width * random.uniform(1, 1.3), width * random.uniform(0.7, 1))
    container = _placed(random, "bin", size, width * random.uniform(0.01, 0.05), 0.0)
    count = _capacity(container, shape) * random.uniform(0.4, 1.1)
    return PilePlan(shape, container, _column(container), int(np.clip(count, 20, min(most, 700))),
                    random.uniform(0.3, 0.6), random.uniform(0, 0.3))


def _shallow_size(random: np.random.Generator, shape: Shape, kind: str, most: int) -> np.ndarray:
    """(3,) inner size in part sizes: a width, and the depth for which a full one holds a drawn
    number of parts, so that the fill drawn later does not depend on the width."""
    width = np.exp(random.uniform(*np.log(_WIDTH)))
    length = width * (
        1.0 if kind in ROUND_KINDS or random.random() < 0.4 else random.uniform(1, 1.8)
    )
    holds = min(np.exp(random.uniform(*np.log(_CAPACITY))), most)
    space = _space(shape)
    low, high = {"tray": (0.4, 1.5), "bowl": (0.3 * width, 0.5 * width),
                 "cup": (0.8 * width, 1.5 * width)}.get(kind, (0.3 * width, 1.1 * width))
    depth = random.uniform(low, high)
    if depth * width * length / space > holds:
        depth = holds * space / (width * length)
    if depth < _LOWEST:  # not one layer of so many parts: a smaller one
        width, length = np.array([width, length]) * np.sqrt(depth / _LOWEST)
        width, length, depth = max(width, _WIDTH[0]), max(length, _WIDTH[0]), _LOWEST
    return np.array([width, length, depth])


def _deep_size(random: np.random.Generator, shape: Shape, kind: str, most: int) -> np.ndarray:
    """(3,) inner size in part sizes: a form, and the width for which a full one holds a drawn
    number of parts; of parts so thin that four part sizes are too wide for that, a lower one."""
    aspect = 1.0 if kind in ROUND_KINDS or random.random() < 0.4 else random.uniform(1, 1.8)
    low, high = {"bowl": (0.3, 0.5), "cup": (0.8, 1.5)}.get(kind, (0.4, 1.2))
    form = random.uniform(low, high)  # depth over width
    space = min(np.exp(random.uniform(*np.log(_CAPACITY))), most) * _space(shape)
    width = float(np.clip((space / (form * aspect)) ** (1 / 3), *_WIDTH))
    depth = max(min(form * width, space / (width**2 * aspect)), _LOWEST)
    return np.array([width, aspect * width, depth])


def _space(shape: Shape) -> float:
    """Room that one part takes in a pile, in cubes of the part size."""
    return shape.unit_volume / shape.part_size**3 / expected_gamma(shape)


def _container(random: np.random.Generator, shape: Shape, kind: str, inner: np.ndarray
               ) -> ContainerShape:
    width, _, depth = inner
    size = inner * shape.part_size
    draft = 0.0
    if kind == "cup" or (kind in ("bin", "tray") and random.random() < 0.5):
        draft = min(np.deg2rad(random.uniform(1, 12)), np.arctan(0.15 * width / depth))
    wall = width * shape.part_size * random.uniform(0.005, 0.08)
    return _placed(random, kind, (size[0], size[1], size[2]), wall, draft)


def _placed(random: np.random.Generator, kind: str, size: tuple[float, float, float],
            wall: float, draft: float) -> ContainerShape:
    turn = random.uniform(-np.pi, np.pi)
    c, s = np.cos(turn), np.sin(turn)
    T = geometry.pose(np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]),
                      np.array([*random.uniform(-0.05, 0.05, 2), 0.0]))
    return ContainerShape(kind, T, size, wall, wall * random.uniform(0.8, 1.2), draft,
                          int(random.integers(2**31)))


def _capacity(container: ContainerShape, shape: Shape) -> float:
    """Parts that the container may hold, level with the rim."""
    rings = container.inner_rings
    (x, y), (u, w) = rings[..., :2].transpose(2, 0, 1), np.roll(rings[..., :2], -1, 1).transpose(
        2, 0, 1)
    volume = trapezoid(np.sum(x * w - u * y, axis=1) / 2, rings[:, 0, 2])
    return float(volume) * expected_gamma(shape) / shape.unit_volume


def _column(container: ContainerShape) -> np.ndarray:
    inner = np.array(container.inner_size_m[:2])
    return inner * (0.7 if container.kind in ROUND_KINDS else 0.95)  # the square in the circle


def _heap(random: np.random.Generator, shape: Shape, most: int, surface: dict) -> PilePlan:
    """Poured through a column; what lies farther out than a heap of a slope of some 15 degrees
    would reach is no part of it."""
    count = int(np.exp(random.uniform(*np.log((20, min(most, 700))))))
    volume = count * shape.unit_volume / expected_gamma(shape)
    radius = max((3 * volume / (np.pi * np.tan(np.deg2rad(15)))) ** (1 / 3),
                 2.5 * shape.part_size)
    region = _placed(random, "none", (2 * radius, 2 * radius, 0.0), 0.0, 0.0)
    side = random.uniform(0.5, 1.2) * radius
    return PilePlan(shape, region, np.array([side, side]), count, **surface)
