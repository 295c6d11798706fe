# SPDX-License-Identifier: Apache-2.0
"""Sparse training parts: open wire frames, piles of which are nearly empty (gamma about 0.05).

`scripts/sparse_shapes.py` scales the solids and writes them to a library. They are not in
`FAMILIES`, so that the sets made from those stay as they are. No frame has a closed loop: in the
engine's steps thin bars may slip through each other, and closed ones would then hang together
like the links of a chain. Bars of open ones come to lie where they could also have been pushed.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

from stack_counter.sim.shapes.solids import bar, polar, union

# Range of the wire's thickness in part sizes, and segments of its outline; chosen.
_THICKNESS, _SIDES = (0.02, 0.045), 8
_GOLDEN = (1 + np.sqrt(5)) / 2

Edges = list[tuple[int, int]]


def _wires(random: np.random.Generator, points: np.ndarray, edges: Edges) -> Manifold:
    """Bars of one thickness between points (n, 3); the largest side is about 1."""
    points = points / np.ptp(points, axis=0).max()
    radius = np.exp(random.uniform(*np.log(_THICKNESS))) / 2
    return union([bar(points[i], points[j], radius, radius, _SIDES) for i, j in edges])


def _circle(n: int, radius: float = 1.0, z: float = 0.0, turn: float = 0.0) -> np.ndarray:
    """(n, 3) corners of a level regular polygon."""
    flat = polar(np.full(n, radius), turn + np.arange(n) * 2 * np.pi / n)
    return np.column_stack([flat, np.full(n, z)])


def _loopless(random: np.random.Generator, edges: Edges, n: int) -> Edges:
    """Some of the edges: they join all n points without a closed loop."""
    group, kept = np.arange(n), []
    for i, j in random.permutation(edges):
        if group[i] != group[j]:
            group[group == group[j]] = group[i]
            kept.append((i, j))
    return kept


def _open_box(random: np.random.Generator) -> Manifold:
    """Seven of the twelve edges of a box."""
    corners = np.array([[i & 1, i >> 1 & 1, i >> 2] for i in range(8)])
    edges = [(i, i | bit) for i in range(8) for bit in (1, 2, 4) if not i & bit]
    return _wires(
        random,
        corners * [1, random.uniform(0.6, 1), random.uniform(0.5, 1)],
        _loopless(random, edges, 8),
    )


def _open_prism(random: np.random.Generator) -> Manifold:
    """Edges of a straight or tapered prism of three or five sides, few enough to stay open."""
    n = int(random.choice([3, 5]))
    corners = np.vstack([_circle(n), _circle(n, random.uniform(0.5, 1), random.uniform(0.8, 2))])
    edges = [(i + k, (i + 1) % n + k) for k in (0, n) for i in range(n)] \
        + [(i, i + n) for i in range(n)]
    return _wires(random, corners, _loopless(random, edges, 2 * n))


def _jack(random: np.random.Generator) -> Manifold:
    """Three to six long bars through one point, in space."""
    ways = np.array([[0, 1, _GOLDEN], [0, -1, _GOLDEN], [1, _GOLDEN, 0], [-1, _GOLDEN, 0],
                     [_GOLDEN, 0, 1], [_GOLDEN, 0, -1]])
    n = int(random.integers(3, 7))
    ends = random.permutation(ways)[:n] * random.uniform(0.7, 1, (n, 1))
    return _wires(random, np.vstack([ends, -ends]), [(i, i + n) for i in range(n)])


def _spider(random: np.random.Generator) -> Manifold:
    """Three, five, six or seven legs with knees."""
    n = int(random.choice([3, 5, 6, 7]))
    knees = _circle(n, random.uniform(0.4, 0.8), random.uniform(0.2, 0.6))
    feet = _circle(n, 1, random.uniform(-1, -0.3))
    edges = [(0, 1 + i) for i in range(n)] + [(1 + i, 1 + n + i) for i in range(n)]
    return _wires(random, np.vstack([[[0, 0, 0]], knees, feet]), edges)


def _grapnel(random: np.random.Generator) -> Manifold:
    """A shaft with three to five barbs at its end."""
    n = int(random.integers(3, 6))
    bends = _circle(n, random.uniform(0.2, 0.35), random.uniform(-0.1, 0.1))
    tips = _circle(n, random.uniform(0.4, 0.6), random.uniform(0.3, 0.6))
    edges = [(0, 1)] + [(0, 2 + i) for i in range(n)] + [(2 + i, 2 + n + i) for i in range(n)]
    return _wires(random, np.vstack([[[0, 0, 0], [0, 0, 1]], bends, tips]), edges)


def _axle(random: np.random.Generator) -> Manifold:
    """A bar with three to five spokes at either end."""
    n, low, high = int(random.integers(3, 6)), *random.uniform(0.35, 0.6, 2)
    rims = [_circle(n, low), _circle(n, high, 1, random.uniform(0, np.pi))]
    edges = [(0, 1)] + [(k, 2 + k * n + i) for k in (0, 1) for i in range(n)]
    return _wires(random, np.vstack([[[0, 0, 0], [0, 0, 1]], *rims]), edges)


def _antenna(random: np.random.Generator) -> Manifold:
    """A mast with three to six cross bars at all turns."""
    n = int(random.integers(3, 7))
    reach, angle = random.uniform(0.25, 0.5, n), random.uniform(0, np.pi, n)
    half = np.column_stack([polar(reach, angle), np.zeros(n)])
    at = np.column_stack([np.zeros((n, 2)), np.linspace(0.05, 0.95, n)])
    return _wires(random, np.vstack([[[0, 0, 0], [0, 0, 1]], at - half, at + half]),
                  [(0, 1)] + [(2 + i, 2 + n + i) for i in range(n)])


def _shrub(random: np.random.Generator) -> Manifold:
    """A trunk, three boughs and two twigs on each of them."""
    boughs = _circle(3, random.uniform(0.3, 0.5), random.uniform(0.2, 0.5))
    spread, top = random.uniform(0.4, 0.9), random.uniform(0.2, 1, 6)
    twigs = np.vstack([_circle(3, 1, 0, -spread / 2), _circle(3, 1, 0, spread / 2)])
    twigs[:, 2] = top
    edges = [(0, 1)] + [(1, 2 + i) for i in range(3)] + [(2 + i % 3, 5 + i) for i in range(6)]
    return _wires(
        random, np.vstack([[[0, 0, -random.uniform(0.3, 1)], [0, 0, 0]], boughs, twigs]), edges
    )


GENERATORS: dict[str, Callable[[np.random.Generator], Manifold]] = {
    f.__name__.lstrip("_"): f for f in (_open_box, _open_prism, _jack, _spider, _grapnel, _axle,
                                        _antenna, _shrub)}


def make_solid(family: str, variant: int) -> Manifold:
    """Makes one of the solids, its largest side about 1; always the same for the same arguments.

    Args:
        family: a key of `GENERATORS`.
        variant: number of the variant, from 0.
    """
    return GENERATORS[family](np.random.default_rng([variant, zlib.crc32(family.encode())]))
