# SPDX-License-Identifier: Apache-2.0
"""Families of turned, milled, punched and moulded parts."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from stack_counter.sim.shapes.solids import SIDES, box, cylinder, largest, polar, polygon, union


def nut(random: np.random.Generator) -> Manifold:
    """Square or hexagonal, with a plain bore."""
    sides = int(random.choice([4, 6]))
    bore = 0.5 * np.cos(np.pi / sides) * random.uniform(0.4, 0.84)
    return cylinder(random.uniform(0.2, 0.9), 0.5, sides) - cylinder(2, bore)


def pin(random: np.random.Generator) -> Manifold:
    """A plain shank with a round, hexagonal, countersunk or domed head."""
    high, wide = random.uniform(0.08, 0.3), random.uniform(0.1, 0.4)
    thin = max(0.04, wide * random.uniform(0.3, 0.75))
    kind = int(random.integers(4))
    head = [lambda: cylinder(high, wide),
            lambda: cylinder(high, wide, 6),
            lambda: Manifold.cylinder(high, thin, wide, SIDES, True),
            lambda: Manifold.sphere(wide, 24).scale([1, 1, high / wide]).trim_by_plane(
                [0, 0, 1], 0)][kind]()
    return head.translate([0, 0, 0.5 - high / 2]) + cylinder(1 - high, thin, 20).translate(
        [0, 0, 0.02 - high / 2])


def bracket(random: np.random.Generator) -> Manifold:
    """An angle, some with a rib or holes."""
    arm, thick, width = (
        random.uniform(0.35, 1),
        random.uniform(0.05, 0.22),
        random.uniform(0.2, 0.9),
    )
    solid = box(1, width, thick).translate([0.5, 0, thick / 2]) \
        + box(thick, width, arm).translate([thick / 2, 0, arm / 2])
    if random.random() < 0.35:
        reach = random.uniform(0.4, 0.9)
        rib = CrossSection([[[0, 0], [reach, 0], [0, arm * reach]]]).extrude(max(0.05, width / 6))
        solid += rib.rotate([90, 0, 0])
    if random.random() < 0.6:
        bore = cylinder(0.8, random.uniform(0.15, 0.32) * min(width, arm - thick), 16)
        solid -= bore.translate([random.uniform(0.6, 0.75), 0, 0])
        solid -= bore.rotate([0, 90, 0]).translate([0, 0, (arm + thick) / 2])
    return largest(solid)


def gear(random: np.random.Generator) -> Manifold:
    """A spur gear of 7 to 24 teeth with a round, square or hexagonal bore."""
    teeth = int(random.integers(7, 25))
    root = 0.5 - random.uniform(0.5, 1.1) * 1.1 / teeth
    angles = (np.arange(teeth)[:, None] + [0, 0.17, 0.4, 0.57]) * 2 * np.pi / teeth
    profile = polygon(polar(np.tile([root, 0.5, 0.5, root], teeth), angles.ravel()))
    bore = CrossSection.circle(root * random.uniform(0.15, 0.75), int(random.choice([4, 6, 20])))
    return (profile - bore).extrude(random.uniform(0.06, 0.7))


def hollow_box(random: np.random.Generator) -> Manifold:
    """An open tray, a box with a window, or a square pipe."""
    size = np.array([1, random.uniform(0.4, 1), random.uniform(0.25, 1)])
    wall = random.uniform(0.045, 0.12)
    inner, up = size - 2 * wall, size[2] / 2
    kind = int(random.integers(3))
    outer = box(*size)
    if kind == 0:
        return outer - box(*inner).translate([0, 0, wall]) - box(*inner).translate([0, 0, up])
    if kind == 1:
        window = box(*(inner[:2] * random.uniform(0.3, 0.8)), 1).translate([0, 0, up])
        return outer - box(*inner) - window
    return outer - box(2, *inner[1:])


def cup(random: np.random.Generator) -> Manifold:
    """A round or polygonal cup, straight or drafted, some with a handle."""
    height, wall, draft = (
        random.uniform(0.3, 1),
        random.uniform(0.05, 0.13),
        random.uniform(0.6, 1),
    )
    sides = int(random.choice([6, 8, SIDES, SIDES]))
    outer = Manifold.cylinder(height, 0.5 * draft, 0.5, sides)
    if random.random() < 0.3:
        loop = CrossSection.circle(0.06, 8).translate([height * 0.3, 0]).revolve(16)
        outer += loop.rotate([90, 0, 0]).translate([0.25 + 0.25 * draft, 0, height / 2])
    inner = Manifold.cylinder(height, 0.5 * draft - wall, 0.5 - wall, sides)
    return outer - inner.translate([0, 0, wall])


def frame(random: np.random.Generator) -> Manifold:
    """A thin polygonal frame of 3 to 6 sides."""
    sides = int(random.integers(3, 7))
    outer = CrossSection.circle(0.5, sides).rotate(180 / sides).scale([1, random.uniform(0.5, 1)])
    inner = outer.offset(-random.uniform(0.045, 0.11), JoinType.Miter)
    return (outer - inner).extrude(random.uniform(0.045, 0.25))


def star(random: np.random.Generator) -> Manifold:
    """A star of 3 to 9 points, flat or tapered (not 4: a cross)."""
    points = int(random.choice([3, 5, 6, 7, 8, 9]))
    radii = np.tile([0.5, 0.5 * random.uniform(0.35, 0.8)], points)
    profile = polygon(polar(radii, np.arange(2 * points) * np.pi / points))
    top = random.uniform(0.3, 1) if random.random() < 0.4 else 1
    return profile.extrude(random.uniform(0.08, 0.7), 0, 0, [top, top])


def flange(random: np.random.Generator) -> Manifold:
    """An oval, triangular or square flange: a bore and a hole at each corner."""
    corners = int(random.integers(2, 5))
    ear = random.uniform(0.11, 0.16)
    at = polar(np.full(corners, 0.5 - ear), np.arange(corners) * 2 * np.pi / corners)
    body = random.uniform(0.25, 0.42)
    outline = CrossSection.batch_hull(
        [CrossSection.circle(body, SIDES)] + [CrossSection.circle(ear, 16).translate(p)
                                              for p in at])
    for p in at:
        outline -= CrossSection.circle(ear * random.uniform(0.35, 0.6), 12).translate(p)
    bore = CrossSection.circle(random.uniform(0.08, 0.2), SIDES)
    hub = cylinder(0.5, 0.24).translate([0, 0, 0.25]) if random.random() < 0.4 else Manifold()
    return outline.extrude(random.uniform(0.05, 0.25)) + hub - bore.extrude(2)


def notched(random: np.random.Generator) -> Manifold:
    """A milled block: corners cut away and holes drilled."""
    size = np.array([1, random.uniform(0.4, 1), random.uniform(0.25, 0.9)])
    solid = box(*size)
    for _ in range(random.integers(1, 4)):
        corner = size / 2 * random.choice([-1, 1], 3)
        solid -= box(*(size * random.uniform(0.3, 0.85, 3))).translate(corner)
    for _ in range(random.integers(0, 3)):
        bore = cylinder(3, random.uniform(0.08, 0.25) * size.min(), 16)
        solid -= bore.rotate(random.choice([0, 90], 3)).translate(
            size * random.uniform(-0.2, 0.2, 3)
        )
    return largest(solid)


def perforated(random: np.random.Generator) -> Manifold:
    """A plate with a grid of round, square or hexagonal holes."""
    columns, rows = int(random.integers(2, 6)), int(random.integers(1, 4))
    pitch = 1 / columns
    hole = CrossSection.circle(
        pitch * random.uniform(0.2, 0.38), int(random.choice([4, 6, 10]))
    ).rotate(45)
    holes = [hole.translate([pitch * (i - (columns - 1) / 2), pitch * (j - (rows - 1) / 2)])
             for i in range(columns) for j in range(rows)]
    outline = CrossSection.square([1, pitch * rows], True)
    return (outline - CrossSection.compose(holes)).extrude(random.uniform(0.045, 0.3))


def comb(random: np.random.Generator) -> Manifold:
    """A bar with 3 to 8 teeth (two would be a U)."""
    teeth = int(random.integers(3, 9))
    tooth, spine, depth = (
        random.uniform(0.35, 0.65) / teeth,
        random.uniform(0.08, 0.3),
        random.uniform(0.05, 0.5),
    )
    tooth = max(tooth, 0.05)
    long = random.uniform(0.15, 0.7)
    profile = CrossSection.square([1, spine])
    for x in np.linspace(0, 1 - tooth, teeth):
        profile += CrossSection.square([tooth, spine + long]).translate([x, 0])
    return profile.extrude(depth)


def propeller(random: np.random.Generator) -> Manifold:
    """A hub with pitched or twisted blades (not 4: a cross)."""
    blades, hub = int(random.choice([2, 3, 5, 6])), random.uniform(0.1, 0.18)
    width = random.uniform(0.12, 0.3)
    section = CrossSection.square([width, random.uniform(0.045, 0.08)], True)
    tip = random.uniform(0.6, 1.3)
    blade = section.extrude(0.5, 6, random.uniform(0, 50), [tip, 1]).rotate(
        [0, 0, random.uniform(20, 70)]).rotate([0, 90, 0])
    solid = union([cylinder(random.uniform(0.15, 0.3), hub, 20)]
                  + [blade.rotate([0, 0, 360 * i / blades]) for i in range(blades)])
    return solid - cylinder(2, hub * random.uniform(0.2, 0.6), 12)


def dumbbell(random: np.random.Generator) -> Manifold:
    """A shaft between two balls, cubes or hexagons."""
    end, kind = random.uniform(0.12, 0.26), int(random.integers(3))
    ball = [Manifold.sphere(end, 20), box(2 * end, 2 * end, 2 * end),
            cylinder(2 * end, end, 6)][kind]
    shaft = cylinder(1 - 2 * end, max(0.03, end * random.uniform(0.25, 0.7)), 16)
    return shaft + ball.translate([0, 0, 0.5 - end]) + ball.translate([0, 0, end - 0.5])


def lever(random: np.random.Generator) -> Manifold:
    """A flat link with an eye at each end."""
    a, b = random.uniform(0.12, 0.28), random.uniform(0.1, 0.22)
    eyes = [CrossSection.circle(a, 24).translate([a - 0.5, 0]),
            CrossSection.circle(b, 24).translate([0.5 - b, 0])]
    holes = [CrossSection.circle(x * random.uniform(0.3, 0.62), 16) for x in (a, b)]
    web = CrossSection.square([0.7, min(a, b) * random.uniform(0.5, 1.4)], True)
    outline = CrossSection.batch_hull(eyes) if random.random() < 0.5 else eyes[0] + eyes[1] + web
    outline -= holes[0].translate([a - 0.5, 0]) + holes[1].translate([0.5 - b, 0])
    return outline.extrude(random.uniform(0.05, 0.35))


def hinge(random: np.random.Generator) -> Manifold:
    """A leaf with holes and knuckles along one edge."""
    wide, radius, thick = (
        random.uniform(0.3, 0.9),
        random.uniform(0.08, 0.14),
        random.uniform(0.045, 0.08),
    )
    bore = cylinder(2, radius - random.uniform(0.045, 0.06), 14).rotate([0, 90, 0])
    knuckles = int(random.integers(1, 4))
    pitch = 1 / (2 * knuckles - 1)
    solid = box(1, wide, thick).translate([0, wide / 2, thick / 2 - radius])
    for i in range(knuckles):
        solid += cylinder(pitch, radius, 16).rotate([0, 90, 0]).translate(
            [2 * i * pitch + pitch / 2 - 0.5, 0, 0])
    for i in range(random.integers(0, 4)):
        solid -= cylinder(1, wide * 0.1, 10).translate([0.3 * i - 0.3, wide * 0.65, 0])
    return largest(solid - bore)
