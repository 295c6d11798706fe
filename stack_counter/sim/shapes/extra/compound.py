# SPDX-License-Identifier: Apache-2.0
"""Compound training parts: bodies put together, mirrored, arrayed, hollowed and cut at random.

What a network has to learn is how any form fills space, not 48 families by heart: these parts have
the steps of design in common, and nothing else. `scripts/compound_shapes.py` scales the solids and
writes them to a library. They are not in `FAMILIES`, so that the sets made from those stay as
they are. A family is how a part was begun and what was done to it.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from stack_counter.sim.shapes.solids import box, cylinder, largest, polygon, rotated, union

# Segments of a circle; least share of the volume that a cut leaves, else it is not made. Chosen.
_SIDES, _LEAST_LEFT = 14, 0.25


def _primitive(random: np.random.Generator, low: float = 0.12, high: float = 0.9) -> Manifold:
    """A box, cylinder, cone, prism, ball or ring of random sides."""
    a, b, c = np.exp(random.uniform(np.log(low), np.log(high), 3))
    kind = int(random.integers(6))
    if kind == 0:
        return box(a, b, c)
    if kind == 1:
        return cylinder(a, b / 2, _SIDES)
    if kind == 2:
        return Manifold.cylinder(a, b / 2, b / 2 * random.uniform(0.2, 0.8), _SIDES, True)
    if kind == 3:
        return cylinder(a, b / 2, int(random.integers(3, 8)))
    if kind == 4:
        return Manifold.sphere(0.5, _SIDES).scale([a, b, c])
    wall = min(b, c) * random.uniform(0.15, 0.35)
    return cylinder(a, b / 2 + wall, _SIDES) - cylinder(2 * a, b / 2, _SIDES)


def _turned(random: np.random.Generator, solid: Manifold) -> Manifold:
    """At a random attitude, most often along the axes."""
    return (
        rotated(solid, random)
        if random.random() < 0.35
        else solid.rotate(90.0 * random.integers(0, 4, 3))
    )


def _corner(random: np.random.Generator, solid: Manifold) -> np.ndarray:
    return random.permutation(solid.to_mesh64().vert_properties[:, :3])[0]


def _joined(random: np.random.Generator) -> Manifold:
    """Two to five primitives, each set into the surface of those before."""
    solid = _turned(random, _primitive(random))
    for _ in range(random.integers(1, 5)):
        at = _corner(random, solid) * random.uniform(0.6, 1.0)
        solid += _turned(random, _primitive(random)).translate(at)
    return largest(solid)


def _lathed(random: np.random.Generator) -> Manifold:
    """A turned body of any profile, with grooves and flanges."""
    n = int(random.integers(3, 8))
    radii = np.exp(random.uniform(np.log(0.06), np.log(0.5), n))
    z = np.sort(random.uniform(0, 1, n - 1))
    z = np.concatenate([[0], z, [1]])
    steps = np.stack([radii.repeat(2), np.stack([z[:-1], z[1:]], axis=1).ravel()], axis=1)
    side = steps if random.random() < 0.6 else np.stack([radii, np.linspace(0, 1, n)], axis=1)
    solid = polygon(np.vstack([[0, 0], side, [0, 1]])).revolve(_SIDES)
    return solid.scale([1, 1, np.exp(random.uniform(-1.2, 0.7))])


def _folded(random: np.random.Generator) -> Manifold:
    """A strip folded along a random path, as wide as it likes."""
    n = int(random.integers(2, 7))
    turns = np.cumsum(random.choice([-1, 1], n) * random.uniform(0.4, 2.0, n))
    lengths = random.uniform(0.15, 0.6, n)
    steps = np.stack([np.cos(turns), np.sin(turns)], axis=1) * lengths[:, None]
    points = np.vstack([[0, 0], np.cumsum(steps, axis=0)])
    thick = np.exp(random.uniform(np.log(0.05), np.log(0.2)))
    path = union([box(np.hypot(*d) + thick, thick, 1).rotate(
        [0, 0, np.degrees(np.arctan2(d[1], d[0]))]).translate([*(p + d / 2), 0])
        for p, d in zip(points, steps)])
    return path.scale([1, 1, np.exp(random.uniform(np.log(0.1), np.log(1.0)))])


def _outline(random: np.random.Generator) -> Manifold:
    """A plate of a random outline, rounded or not."""
    parts = [
        CrossSection.square(random.uniform(0.1, 0.9, 2), True)
        .rotate(random.uniform(0, 360))
        .translate(random.uniform(-0.3, 0.3, 2))
        for _ in range(random.integers(1, 5))
    ]
    flat = parts[0]
    for part in parts[1:]:
        flat = (
            flat - part
            if random.random() < 0.25 and flat.area() > 3 * part.area()
            else flat + part
        )
    flat = flat.offset(-0.03, JoinType.Miter).offset(
        random.uniform(0.03, 0.08),
        JoinType.Round if random.random() < 0.5 else JoinType.Miter,
        2,
        12,
    )
    return largest(flat.extrude(np.exp(random.uniform(np.log(0.06), np.log(0.9)))))


def _centred(solid: Manifold) -> Manifold:
    low, high = np.split(np.array(solid.bounding_box()), 2)
    return solid.translate(-(low + high) / 2).scale([1 / float((high - low).max())] * 3)


def _mirrored(random: np.random.Generator, solid: Manifold) -> Manifold:
    """With its mirror image, at a plane through it."""
    normal = np.eye(3)[random.integers(3)]
    solid = solid.translate(-normal * random.uniform(-0.4, 0.4))
    return largest(solid + solid.mirror(normal))


def _arrayed(random: np.random.Generator, solid: Manifold) -> Manifold:
    """Two to six of it around an axis, with a hub where they do not meet."""
    n = int(random.integers(2, 7))
    arm = solid.scale([1, random.uniform(0.25, 0.7), random.uniform(0.25, 0.9)]).translate(
        [random.uniform(0.25, 0.6), 0, 0])
    around = [arm.rotate([0, 0, 360 * i / n]) for i in range(n)]
    low, high = np.split(np.array(arm.bounding_box()), 2)
    hub = cylinder(max(float(high[2] - low[2]) * random.uniform(0.3, 1.2), 0.06),
                   max(float(low[0]) + 0.08, 0.08), _SIDES).translate(
        [0, 0, float(low[2] + high[2]) / 2])
    return largest(union([*around, hub]))


def _hollowed(random: np.random.Generator, solid: Manifold) -> Manifold:
    """Open on one side or bored through along an axis, walls of a tenth or more."""
    axis, inner = int(random.integers(3)), random.uniform(0.5, 0.85)
    shift = np.eye(3)[axis] * random.choice([-1, 1]) * (1 - inner)
    scale = np.full(3, inner)
    if random.random() < 0.3:
        scale[axis] = 1.5
    return _cut(solid, solid.scale(scale).translate(shift))


def _machined(random: np.random.Generator, solid: Manifold) -> Manifold:
    """With one to four slots, holes and pockets."""
    for _ in range(random.integers(1, 5)):
        tool = _turned(random, _primitive(random, 0.08, 0.5)).scale(
            [3.0 if i == random.integers(3) else 1.0 for i in range(3)])
        solid = _cut(solid, tool.translate(_corner(random, solid) * random.uniform(0, 1)))
    return solid


def _cut(solid: Manifold, tool: Manifold) -> Manifold:
    rest = largest(solid - tool)
    return rest if rest.volume() > _LEAST_LEFT * solid.volume() else solid


Step = Callable[[np.random.Generator, Manifold], Manifold]
_BEGIN: dict[str, Callable[[np.random.Generator], Manifold]] = {
    "joined": _joined, "lathed": _lathed, "folded": _folded, "outline": _outline}
_STEPS: dict[str, tuple[Step, ...]] = {
    "plain": (), "mirrored": (_mirrored,), "arrayed": (_arrayed,), "hollowed": (_hollowed,),
    "machined": (_machined,), "both": (_mirrored, _machined)}
GENERATORS = tuple(f"{begin}_{steps}" for begin in _BEGIN for steps in _STEPS)


def make_solid(family: str, variant: int) -> Manifold:
    """Makes a part of a family, not yet scaled; the same for the same variant."""
    random = np.random.default_rng([variant, zlib.crc32(family.encode())])
    begin, steps = family.split("_")
    made = _centred(_BEGIN[begin](random))
    for step in _STEPS[steps]:
        made = _centred(step(random, made))
    return made
