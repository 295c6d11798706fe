# SPDX-License-Identifier: Apache-2.0
"""Hand-written solids of the unseen test set: families on which nothing is ever trained.

Lengths are relative; `scripts/join_unseen_shapes.py` scales the solids and writes them to
`data/unseen/shapes.npz`, which is what the tests read.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable

import numpy as np
from manifold3d import CrossSection, Manifold, OpType

# Segments of a circle; chosen.
_SIDES = 32


def _disc(radius: float, x: float = 0, y: float = 0, sides: int = _SIDES) -> CrossSection:
    return CrossSection.circle(radius, sides).translate([x, y])


def _bar(width: float, height: float, x: float = 0, y: float = 0) -> CrossSection:
    return CrossSection.square([width, height], True).translate([x, y])


def _rod(height: float, radius: float, sides: int = _SIDES) -> Manifold:
    return Manifold.cylinder(height, radius, radius, sides)


def _box(size: list[float], at: list[float]) -> Manifold:
    return Manifold.cube(size, True).translate(at)


def _joined(solids: list[Manifold]) -> Manifold:
    return Manifold.batch_boolean(solids, OpType.Add)


def _turned(outline: list[tuple[float, float]]) -> Manifold:
    """Revolved outline; its points are (radius, height), counter-clockwise."""
    return CrossSection([outline]).revolve(_SIDES)


def _pipes(random: np.random.Generator, directions: list[list[float]]) -> Manifold:
    """Stubs with collars that meet at the origin; blind square sockets in their ends."""
    radius, reach = random.uniform(0.14, 0.2), random.uniform(0.4, 0.5)
    stub = _rod(reach, radius) + _rod(0.12, radius * random.uniform(1.2, 1.4)).translate(
        [0, 0, reach - 0.12])
    socket = _rod(0.1, radius * random.uniform(0.25, 0.4), 4).translate([0, 0, reach - 0.05])
    return _joined([stub.rotate(angles) for angles in directions]) \
        - _joined([socket.rotate(angles) for angles in directions])


def _t_fitting(random: np.random.Generator) -> Manifold:
    return _pipes(random, [[0, 90, 0], [0, -90, 0], [0, 0, 0]])


def _cross(random: np.random.Generator) -> Manifold:
    if random.random() < 0.5:
        return _pipes(random, [[0, 90, 0], [0, -90, 0], [0, 0, 0], [180, 0, 0]])
    arm = random.uniform(0.18, 0.3)
    profile = _bar(1, arm) + _bar(arm, random.uniform(0.7, 1)) + _disc(arm * 0.85)
    return (profile - _disc(arm * 0.4)).extrude(random.uniform(0.12, 0.25))


def _bottle(random: np.random.Generator) -> Manifold:
    """A closed bottle: solid, as its contents are in it."""
    radius, neck = random.uniform(0.16, 0.27), random.uniform(0.07, 0.12)
    shoulder = random.uniform(0.5, 0.7)
    return _turned([(0, 0), (radius - 0.03, 0), (radius, 0.03), (radius, shoulder), (neck, 0.82),
                    (neck, 0.88), (neck + 0.03, 0.89), (neck + 0.03, 1), (0, 1)])


def _jar(random: np.random.Generator) -> Manifold:
    """A jar with its lid on; the lid is ribbed."""
    radius, height, lid = (
        random.uniform(0.28, 0.42),
        random.uniform(0.6, 0.75),
        random.uniform(0.16, 0.24),
    )
    body = _turned([(0, 0), (radius - 0.05, 0), (radius, 0.05), (radius, height - 0.12),
                    (radius * 0.75, height), (0, height)])
    ribs = int(random.integers(10, 16))
    angle = np.linspace(0, 2 * np.pi, 8 * ribs, endpoint=False)
    edge = radius * (0.9 + 0.05 * np.sign(np.sin(ribs * angle)))
    profile = CrossSection([np.stack([edge * np.cos(angle), edge * np.sin(angle)], axis=1)])
    return body + profile.extrude(lid).translate([0, 0, height - 0.02])


def _pulley(random: np.random.Generator) -> Manifold:
    """A grooved wheel with a hub on one side; a blind square hole in the hub."""
    half, groove, hub = (
        random.uniform(0.1, 0.16),
        random.uniform(0.1, 0.2),
        random.uniform(0.2, 0.27),
    )
    low = -2 * half * random.uniform(0.7, 1.1)
    body = _turned([(0, low), (hub, low), (hub, -half), (0.5, -half), (0.5, -0.7 * half),
                    (0.5 - groove, -0.1 * half), (0.5 - groove, 0.1 * half), (0.5, 0.7 * half),
                    (0.5, half), (0, half)])
    return body - _rod(1, hub * random.uniform(0.4, 0.6), 4).translate([0, 0, -half - 1])


def _wheel(random: np.random.Generator) -> Manifold:
    spokes, rim = int(random.integers(3, 6)), random.uniform(0.07, 0.12)
    width, hub = random.uniform(0.15, 0.3), random.uniform(0.12, 0.18)
    tyre = (_disc(0.5, sides=48) - _disc(0.5 - rim, sides=48)).extrude(width)
    web = _joined([_box([0.45, 0.08, width / 2], [0.225, 0, width / 2]).rotate([0, 0, a])
                   for a in np.arange(spokes) * 360 / spokes])
    nave = _rod(width * 1.5, hub).translate([0, 0, -width / 4])
    return tyre + web + nave - _rod(2, hub * 0.5).translate([0, 0, -1])


def _u_channel(random: np.random.Generator) -> Manifold:
    width, height, wall = (
        random.uniform(0.3, 0.5),
        random.uniform(0.25, 0.5),
        random.uniform(0.06, 0.1),
    )
    profile = _bar(width, height) - _bar(width - 2 * wall, height, 0, wall)
    hole = _rod(1, width * 0.17).rotate([90, 0, 0])
    return profile.extrude(1) - hole.translate([0, 0, 0.22]) - hole.translate([0, 0, 0.78])


def _z_clip(random: np.random.Generator) -> Manifold:
    step, thick = random.uniform(0.25, 0.5), random.uniform(0.07, 0.12)
    width, foot = random.uniform(0.3, 0.6), random.uniform(0.4, 0.5)
    profile = _bar(thick, step) + _bar(foot, thick, (foot - thick) / 2, (step - thick) / 2) \
        + _bar(foot, thick, (thick - foot) / 2, (thick - step) / 2)
    hole = _rod(2, width * 0.2).rotate([90, 0, 0]).translate([0, 1, width / 2])
    at = foot / 2 + thick / 4
    return profile.extrude(width) - hole.translate([at, 0, 0]) - hole.translate([-at, 0, 0])


def _knob(random: np.random.Generator) -> Manifold:
    lobes, tall = int(random.integers(3, 8)), random.uniform(0.2, 0.35)
    angle = np.linspace(0, 2 * np.pi, 12 * lobes, endpoint=False)
    radius = 0.42 + 0.08 * np.cos(lobes * angle)
    head = CrossSection([np.stack([radius * np.cos(angle), radius * np.sin(angle)], axis=1)])
    boss = random.uniform(0.18, 0.26)
    knob = head.extrude(tall) + _rod(tall * 1.8, boss).translate([0, 0, -tall * 0.8])
    return knob - _rod(tall, boss * 0.5).translate([0, 0, -tall * 0.9])


def _toy_brick(random: np.random.Generator) -> Manifold:
    """Studs above, hollow below."""
    long, wide, tall = (
        int(random.integers(2, 5)),
        int(random.integers(1, 3)),
        random.choice([0.4, 1.2]),
    )
    wall = 0.2
    brick = _box([long, wide, tall], [0, 0, tall / 2]) \
        - _box([long - 2 * wall, wide - 2 * wall, tall], [0, 0, tall / 2 - wall])
    places = [(i - (long - 1) / 2, j - (wide - 1) / 2) for i in range(long) for j in range(wide)]
    studs = [_rod(0.25, 0.3, 20).translate([x, y, tall - 0.01]) for x, y in places]
    return _joined([brick, *studs])


def _wing_nut(random: np.random.Generator) -> Manifold:
    hub, tall, thick = (
        random.uniform(0.16, 0.22),
        random.uniform(0.2, 0.3),
        random.uniform(0.07, 0.1),
    )
    rise = random.uniform(0.25, 0.4)
    wing = CrossSection.batch_hull([_disc(0.1, 0.4, tall + rise), _disc(0.05, hub, 0.05),
                                    _disc(0.05, hub, tall)])
    leaf = wing.extrude(thick).translate([0, 0, -thick / 2]).rotate([90, 0, 0])
    body = Manifold.cylinder(tall, hub * 1.2, hub, _SIDES)
    return body + leaf + leaf.rotate([0, 0, 180]) - _rod(2, hub * 0.55).translate([0, 0, -1])


def _key(random: np.random.Generator) -> Manifold:
    bow, thick = random.uniform(0.15, 0.2), random.uniform(0.06, 0.1)
    teeth = [_bar(0.06, random.uniform(0.06, 0.2), x, -0.05) for x in (0.6, 0.7, 0.8)]
    blade = CrossSection.batch_boolean([_bar(0.8, 0.09, 0.48), *teeth], OpType.Add)
    return (_disc(bow) + blade - _disc(bow * 0.5)).extrude(thick)


def _pawn(random: np.random.Generator) -> Manifold:
    base, waist, head = (
        random.uniform(0.27, 0.35),
        random.uniform(0.09, 0.14),
        random.uniform(0.15, 0.2),
    )
    collar = waist + random.uniform(0.06, 0.1)
    low = 1 - 2 * head
    body = _turned([(0, 0), (base, 0), (base, 0.1), (base * 0.75, 0.17), (waist * 1.2, 0.3),
                    (waist, low - 0.03), (collar, low), (collar, low + 0.06), (0, low + 0.06)])
    return body + Manifold.sphere(head, 24).translate([0, 0, 1 - head])


def _saddle_clamp(random: np.random.Generator) -> Manifold:
    radius, thick, width = (
        random.uniform(0.18, 0.26),
        random.uniform(0.06, 0.09),
        random.uniform(0.2, 0.35),
    )
    ears = _bar(1, thick, 0, thick / 2)
    arch = (_disc(radius + thick) + ears - _disc(radius)) ^ _bar(2, 1, 0, 0.5)
    hole = _rod(2, 0.07).rotate([90, 0, 0]).translate([0, 1, width / 2])
    at = (0.5 + radius + thick) / 2
    return arch.extrude(width) - hole.translate([at, 0, 0]) - hole.translate([-at, 0, 0])


def _spoon(random: np.random.Generator) -> Manifold:
    long, wide = random.uniform(0.17, 0.22), random.uniform(0.12, 0.16)
    bowl = Manifold.sphere(1, _SIDES).scale([long, wide, 0.1])
    bowl = (bowl - bowl.scale([0.8, 0.75, 0.65])).trim_by_plane([0, 0, -1], 0)
    grip = CrossSection.batch_hull(
        [_disc(0.03, long * 0.93), _disc(random.uniform(0.04, 0.07), 0.78)]
    )
    return bowl + grip.extrude(0.05).translate([0, 0, -0.05])


def _fork(random: np.random.Generator) -> Manifold:
    tines, pitch, long = (
        int(random.integers(2, 5)),
        random.uniform(0.09, 0.11),
        random.uniform(0.22, 0.32),
    )
    across = (np.arange(tines) - (tines - 1) / 2) * pitch
    palm = CrossSection.batch_hull([_disc(0.025, 0.5), *(_disc(0.03, long, y) for y in across)])
    grip = CrossSection.batch_hull([_disc(0.025, 0.5), _disc(random.uniform(0.04, 0.06), 0.95)])
    prongs = [_bar(long, 0.05, long / 2, y) for y in across]
    return CrossSection.batch_boolean([palm, grip, *prongs], OpType.Add).extrude(0.05)


def _figurine(random: np.random.Generator) -> Manifold:
    """Head, trunk, two arms, two legs apart on a foot plate."""
    head, wide, deep = (
        random.uniform(0.1, 0.13),
        random.uniform(0.28, 0.36),
        random.uniform(0.14, 0.2),
    )
    legs = [_box([wide * 0.38, deep, 0.4], [s * wide * 0.3, 0, 0.22]) for s in (-1, 1)]
    swing = random.uniform(-60, 60, 2)
    arms = [_box([0.09, 0.1, 0.32], [0, 0, -0.12]).rotate([swing[i], 0, 0]).translate(
        [s * (wide / 2 + 0.03), 0, 0.66]) for i, s in enumerate((-1, 1))]
    trunk = _box([wide, deep, 0.36], [0, 0, 0.56])
    skull = Manifold.sphere(head, 20).translate([0, 0, 0.7 + head])
    return _joined([trunk, skull, *legs, *arms, _rod(0.06, wide * 0.65)])


def _eye_bolt(random: np.random.Generator) -> Manifold:
    thin = random.uniform(0.06, 0.08)
    eye = _disc(thin, random.uniform(0.15, 0.19), sides=16).revolve(_SIDES).rotate([90, 0, 0])
    shank = _rod(0.6, thin * random.uniform(0.8, 1.1)).rotate([180, 0, 0]).translate([0, 0, -0.15])
    return eye + shank + _rod(0.06, thin * 2).translate([0, 0, -0.3])


def _puzzle_piece(random: np.random.Generator) -> Manifold:
    tab = random.uniform(0.1, 0.13)
    piece = _bar(0.7, 0.7)
    for i, side in enumerate(random.permutation([1, 1, -1, -1])):
        at = np.array([[1, 0], [0, 1], [-1, 0], [0, -1]][i]) * (0.35 + side * 0.7 * tab)
        piece = piece + _disc(tab, *at) if side > 0 else piece - _disc(tab, *at)
    return piece.extrude(random.uniform(0.1, 0.25))


GENERATORS: dict[str, tuple[Callable[[np.random.Generator], Manifold], int]] = {
    f.__name__.lstrip("_"): (f, variants) for f, variants in (
        (_t_fitting, 3), (_cross, 2), (_bottle, 3), (_jar, 2), (_pulley, 3), (_wheel, 2),
        (_u_channel, 2), (_z_clip, 3), (_knob, 3), (_toy_brick, 4), (_wing_nut, 2), (_key, 2),
        (_pawn, 2), (_saddle_clamp, 2), (_spoon, 2), (_fork, 2), (_figurine, 2),
        (_eye_bolt, 2), (_puzzle_piece, 2))}


def make_solid(family: str, variant: int) -> Manifold:
    """Makes one of the solids, of no particular size; always the same for the same arguments.

    Args:
        family: a key of `GENERATORS`, which also holds how many variants the test set has.
        variant: number of the variant, from 0.
    """
    return GENERATORS[family][0](np.random.default_rng([variant, zlib.crc32(family.encode())]))
