# SPDX-License-Identifier: Apache-2.0
"""Families of plain bodies: most are convex or have one bore."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from stack_counter.sim.shapes.solids import SIDES, bar, box, cylinder, direction


def block(random: np.random.Generator) -> Manifold:
    """A brick, some with chamfered edges."""
    size = np.array([1, random.uniform(0.3, 1), random.uniform(0.25, 1)])
    cut = 2 * random.uniform(0.03, 0.3) * size.min() * (random.random() < 0.4)
    return Manifold.batch_hull([box(*(size - cut * (np.arange(3) != i))) for i in range(3)])


def plate(random: np.random.Generator) -> Manifold:
    """From a square tile to a long strip, some with round corners."""
    width = random.uniform(0.12, 1)
    profile = CrossSection.square([1, width], True)
    if random.random() < 0.4:
        corner = width * random.uniform(0.1, 0.48)
        profile = CrossSection.square([1 - 2 * corner, width - 2 * corner], True).offset(
            corner, JoinType.Round, 2, SIDES)
    return profile.extrude(random.uniform(0.04, min(0.3, 0.7 * width)))


def rod(random: np.random.Generator) -> Manifold:
    """Square, hexagonal or round; 3 to 15 times as long as wide."""
    return cylinder(1, 0.5 / random.uniform(3, 15), int(random.choice([4, 6, SIDES])))


def tube(random: np.random.Generator) -> Manifold:
    """From a short sleeve to a long pipe, thin or thick."""
    aspect = np.exp(random.uniform(np.log(0.35), np.log(5)))  # length / diameter
    radius = 0.5 * min(1, 1 / aspect)
    wall = random.uniform(0.04, 0.8 * radius)
    return cylinder(min(1, aspect), radius) - cylinder(2, radius - wall)


def ring(random: np.random.Generator) -> Manifold:
    """A torus with a round or oval section."""
    thin = random.uniform(0.03, 0.19)
    section = CrossSection.circle(thin, 12).scale([1, random.uniform(0.7, 1.6)])
    return section.translate([0.5 - thin, 0]).revolve(SIDES)


def washer(random: np.random.Generator) -> Manifold:
    """A flat disc with a bore."""
    return cylinder(random.uniform(0.04, 0.3), 0.5) - cylinder(2, random.uniform(0.08, 0.44))


def capsule(random: np.random.Generator) -> Manifold:
    """A pill, or a drop with one end thinner."""
    a = random.uniform(0.08, 0.4)
    b = a * (1 if random.random() < 0.6 else random.uniform(0.3, 0.9))
    return bar(np.array([0, 0, a - 0.5]), np.array([0, 0, 0.5 - b]), a, b, 24)


def ball(random: np.random.Generator) -> Manifold:
    """A sphere: smooth or facetted, a little out of round."""
    return Manifold.sphere(0.5, int(random.choice([8, 12, 20, 28]))).scale(
        [1, *random.uniform(0.88, 1, 2)]
    )


def ellipsoid(random: np.random.Generator) -> Manifold:
    """From a smartie to a rice grain."""
    return Manifold.sphere(0.5, SIDES).scale(
        [1, random.uniform(0.25, 0.95), random.uniform(0.2, 0.9)]
    )


def lens(random: np.random.Generator) -> Manifold:
    """Two caps, or one cap and a plane."""
    radius, half = random.uniform(0.52, 1.1), random.uniform(0.07, 0.3)
    disc = CrossSection.circle(radius, 48)
    lower = CrossSection.square([4, 2], True).translate([0, 1]) if random.random() < 0.4 \
        else disc.translate([0, radius - half])
    profile = disc.translate([0, half - radius]) ^ lower
    return profile.revolve(SIDES)


def wedge(random: np.random.Generator) -> Manifold:
    """A triangle or trapeze with depth."""
    top, height = random.uniform(0, 0.95), random.uniform(0.25, 0.9)
    flat = random.uniform(0, 1 - top) * (random.random() < 0.5)
    profile = CrossSection([[[0, 0], [1, 0], [top + flat, height], [top, height]]])
    return profile.extrude(random.uniform(0.12, 1))


def cone(random: np.random.Generator) -> Manifold:
    """A cone or frustum, some with a bore."""
    height, low = random.uniform(0.3, 1), random.uniform(0.2, 0.5)
    bore = random.random() < 0.35
    high = low * random.uniform(0.45 if bore else 0, 0.85)
    solid = Manifold.cylinder(height, low, high, SIDES, True)
    return solid - cylinder(2, high - random.uniform(0.045, 0.08)) if bore else solid


def prism(random: np.random.Generator) -> Manifold:
    """A short regular prism, some pressed flat."""
    solid = cylinder(random.uniform(0.15, 1.2), 0.5, int(random.choice([3, 5, 6, 7, 8])))
    return solid.scale([1, random.uniform(0.5, 1) if random.random() < 0.4 else 1, 1])


def pyramid(random: np.random.Generator) -> Manifold:
    """A pyramid, whole or cut, of 3 to 6 sides."""
    solid = Manifold.cylinder(
        random.uniform(0.35, 1.1), 0.5, random.uniform(0, 0.3), int(random.integers(3, 7))
    )
    return solid.scale([1, random.uniform(0.5, 1), 1])


def dome(random: np.random.Generator) -> Manifold:
    """A cap of a ball, solid or hollow."""
    ball = Manifold.sphere(0.5, SIDES)
    if random.random() < 0.7:
        ball -= Manifold.sphere(0.5 - random.uniform(0.045, 0.3), SIDES)
    return ball.trim_by_plane([0, 0, 1], random.uniform(-0.15, 0.15)).scale(
        [1, 1, random.uniform(0.7, 1.3)]
    )


def pebble(random: np.random.Generator) -> Manifold:
    """The hull of random points: a facetted stone."""
    points = np.array([direction(random) for _ in range(random.integers(8, 40))])
    return Manifold.hull_points(
        points * [0.5, random.uniform(0.25, 0.5), random.uniform(0.15, 0.5)]
    )
