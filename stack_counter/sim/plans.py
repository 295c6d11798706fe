"""What to simulate: a random part, container, number of parts and surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.integrate import trapezoid

from stack_counter import geometry
from stack_counter.sim.containers import ROUND, ContainerShape
from stack_counter.sim.shapes import Shape

MIN_PARTS, MAX_PARTS = 12, 1000
_SHARES = {"bin": 0.42, "cylinder": 0.1, "bowl": 0.08, "cup": 0.07, "tray": 0.1, "bag": 0.06,
           "none": 0.17}
_WIDTH = (4.0, 20.0)  # smaller inner side, in part sizes
_CAPACITY = (60.0, 1000.0)  # parts that the full container holds
_FILL = (0.06, 1.15)  # of the depth


@dataclass(frozen=True)
class Plan:
    """What to drop where; metres.

    Attributes:
        pour_m: (2,) sides of the column that the parts fall through.
        count: parts dropped.
        friction, restitution: of all contacts.
        taps: how often the container is shaken when it is filled.
    """

    shape: Shape
    container: ContainerShape
    pour_m: np.ndarray
    count: int
    friction: float = 0.4
    restitution: float = 0.1
    taps: int = 0


def packing_guess(shape: Shape) -> float:
    """gamma to expect, for choosing a number of parts: concave parts are looser."""
    return 0.58 * shape.convexity**0.6


def random_plan(random: np.random.Generator, shape: Shape, most: int = MAX_PARTS) -> Plan:
    """One scene of the training distribution: any container, any fill, at most `most` parts."""
    kind = str(random.choice(list(_SHARES), p=list(_SHARES.values())))
    surface = {"friction": random.uniform(0.2, 0.7), "restitution": random.uniform(0, 0.3),
               "taps": int(random.integers(3, 7)) if random.random() < 0.25 else 0}
    if kind == "none":
        return _heap(random, shape, most, surface)
    container = _random_container(random, shape, kind, most)
    count = _capacity(container, shape) * random.uniform(*_FILL)
    return Plan(shape, container, _column(container),
                int(np.clip(count, MIN_PARTS, most)), **surface)


def box_plan(random: np.random.Generator, shape: Shape, most: int = MAX_PARTS) -> Plan:
    """One scene like those of the paper's test set: a box about five parts wide, part to
    heaped full. Source: paper, section 4 and supplement, "Simulation"."""
    width = random.uniform(4, 6.5) * shape.part_size
    size = (width, width * random.uniform(1, 1.3), width * random.uniform(0.7, 1))
    container = _placed(random, "bin", size, width * random.uniform(0.01, 0.05), 0.0)
    count = _capacity(container, shape) * random.uniform(0.4, 1.1)
    return Plan(shape, container, _column(container), int(np.clip(count, 20, min(most, 700))),
                random.uniform(0.3, 0.6), random.uniform(0, 0.3))


def _random_container(random: np.random.Generator, shape: Shape, kind: str, most: int
                      ) -> ContainerShape:
    """Width, and the depth for which a full one holds a drawn number of parts: so the fill drawn
    later does not depend on the width."""
    width = np.exp(random.uniform(*np.log(_WIDTH)))
    length = width * (1.0 if kind in ROUND or random.random() < 0.4 else random.uniform(1, 1.8))
    holds = min(np.exp(random.uniform(*np.log(_CAPACITY))), most)
    part = shape.unit_volume / shape.part_size**3 / packing_guess(shape)
    low, high = {"tray": (0.4, 1.5), "bowl": (0.3 * width, 0.5 * width),
                 "cup": (0.8 * width, 1.5 * width)}.get(kind, (0.3 * width, 1.1 * width))
    depth = random.uniform(low, high)
    if depth * width * length / part > holds:
        depth = holds * part / (width * length)
    if depth < 0.5:  # not one layer of so many parts: a smaller one
        width, length = np.array([width, length]) * np.sqrt(depth / 0.5)
        width, length, depth = max(width, _WIDTH[0]), max(length, _WIDTH[0]), 0.5
    size = np.array([width, length, depth]) * shape.part_size
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
    return float(volume) * packing_guess(shape) / shape.unit_volume


def _column(container: ContainerShape) -> np.ndarray:
    inner = np.array(container.inner_size_m[:2])
    return inner * (0.7 if container.kind in ROUND else 0.95)  # the square in the circle


def _heap(random: np.random.Generator, shape: Shape, most: int, surface: dict) -> Plan:
    """Poured through a column; what lies farther out than a heap of a slope of some 15 degrees
    would reach is no part of it."""
    count = int(np.exp(random.uniform(*np.log((20, min(most, 700))))))
    volume = count * shape.unit_volume / packing_guess(shape)
    radius = max((3 * volume / (np.pi * np.tan(np.deg2rad(15)))) ** (1 / 3),
                 2.5 * shape.part_size)
    region = _placed(random, "none", (2 * radius, 2 * radius, 0.0), 0.0, 0.0)
    side = random.uniform(0.5, 1.2) * radius
    return Plan(shape, region, np.array([side, side]), count, **surface)
