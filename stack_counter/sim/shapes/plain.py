"""Families of plain bodies: most are convex or have one bore."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from stack_counter.sim.shapes.solids import SIDES, bar, box, cylinder, direction


def block(r: np.random.Generator) -> Manifold:
    """A brick, some with chamfered edges."""
    size = np.array([1, r.uniform(0.3, 1), r.uniform(0.25, 1)])
    cut = 2 * r.uniform(0.03, 0.3) * size.min() * (r.random() < 0.4)
    return Manifold.batch_hull([box(*(size - cut * (np.arange(3) != i))) for i in range(3)])


def plate(r: np.random.Generator) -> Manifold:
    """From a square tile to a long strip, some with round corners."""
    width = r.uniform(0.12, 1)
    profile = CrossSection.square([1, width], True)
    if r.random() < 0.4:
        corner = width * r.uniform(0.1, 0.48)
        profile = CrossSection.square([1 - 2 * corner, width - 2 * corner], True).offset(
            corner, JoinType.Round, 2, SIDES)
    return profile.extrude(r.uniform(0.04, min(0.3, 0.7 * width)))


def rod(r: np.random.Generator) -> Manifold:
    """Square, hexagonal or round; 3 to 15 times as long as wide."""
    return cylinder(1, 0.5 / r.uniform(3, 15), int(r.choice([4, 6, SIDES])))


def tube(r: np.random.Generator) -> Manifold:
    """From a short sleeve to a long pipe, thin or thick."""
    aspect = np.exp(r.uniform(np.log(0.35), np.log(5)))  # length / diameter
    radius = 0.5 * min(1, 1 / aspect)
    wall = r.uniform(0.04, 0.8 * radius)
    return cylinder(min(1, aspect), radius) - cylinder(2, radius - wall)


def ring(r: np.random.Generator) -> Manifold:
    """A torus with a round or oval section."""
    thin = r.uniform(0.03, 0.19)
    section = CrossSection.circle(thin, 12).scale([1, r.uniform(0.7, 1.6)])
    return section.translate([0.5 - thin, 0]).revolve(SIDES)


def washer(r: np.random.Generator) -> Manifold:
    """A flat disc with a bore."""
    return cylinder(r.uniform(0.04, 0.3), 0.5) - cylinder(2, r.uniform(0.08, 0.44))


def capsule(r: np.random.Generator) -> Manifold:
    """A pill, or a drop with one end thinner."""
    a = r.uniform(0.08, 0.4)
    b = a * (1 if r.random() < 0.6 else r.uniform(0.3, 0.9))
    return bar([0, 0, a - 0.5], [0, 0, 0.5 - b], a, b, 24)


def ball(r: np.random.Generator) -> Manifold:
    """A sphere: smooth or facetted, a little out of round."""
    return Manifold.sphere(0.5, int(r.choice([8, 12, 20, 28]))).scale([1, *r.uniform(0.88, 1, 2)])


def ellipsoid(r: np.random.Generator) -> Manifold:
    """From a smartie to a rice grain."""
    return Manifold.sphere(0.5, SIDES).scale([1, r.uniform(0.25, 0.95), r.uniform(0.2, 0.9)])


def lens(r: np.random.Generator) -> Manifold:
    """Two caps, or one cap and a plane."""
    radius, half = r.uniform(0.52, 1.1), r.uniform(0.07, 0.3)
    disc = CrossSection.circle(radius, 48)
    lower = CrossSection.square([4, 2], True).translate([0, 1]) if r.random() < 0.4 \
        else disc.translate([0, radius - half])
    profile = disc.translate([0, half - radius]) ^ lower
    return profile.revolve(SIDES)


def wedge(r: np.random.Generator) -> Manifold:
    """A triangle or trapeze with depth."""
    top, height = r.uniform(0, 0.95), r.uniform(0.25, 0.9)
    flat = r.uniform(0, 1 - top) * (r.random() < 0.5)
    profile = CrossSection([[[0, 0], [1, 0], [top + flat, height], [top, height]]])
    return profile.extrude(r.uniform(0.12, 1))


def cone(r: np.random.Generator) -> Manifold:
    """A cone or frustum, some with a bore."""
    height, low = r.uniform(0.3, 1), r.uniform(0.2, 0.5)
    bore = r.random() < 0.35
    high = low * r.uniform(0.45 if bore else 0, 0.85)
    solid = Manifold.cylinder(height, low, high, SIDES, True)
    return solid - cylinder(2, high - r.uniform(0.045, 0.08)) if bore else solid


def prism(r: np.random.Generator) -> Manifold:
    """A short regular prism, some pressed flat."""
    solid = cylinder(r.uniform(0.15, 1.2), 0.5, int(r.choice([3, 5, 6, 7, 8])))
    return solid.scale([1, r.uniform(0.5, 1) if r.random() < 0.4 else 1, 1])


def pyramid(r: np.random.Generator) -> Manifold:
    """A pyramid, whole or cut, of 3 to 6 sides."""
    solid = Manifold.cylinder(r.uniform(0.35, 1.1), 0.5, r.uniform(0, 0.3), int(r.integers(3, 7)))
    return solid.scale([1, r.uniform(0.5, 1), 1])


def dome(r: np.random.Generator) -> Manifold:
    """A cap of a ball, solid or hollow."""
    ball = Manifold.sphere(0.5, SIDES)
    if r.random() < 0.7:
        ball -= Manifold.sphere(0.5 - r.uniform(0.045, 0.3), SIDES)
    return ball.trim_by_plane([0, 0, 1], r.uniform(-0.15, 0.15)).scale([1, 1, r.uniform(0.7, 1.3)])


def pebble(r: np.random.Generator) -> Manifold:
    """The hull of random points: a facetted stone."""
    points = np.array([direction(r) for _ in range(r.integers(8, 40))])
    return Manifold.hull_points(points * [0.5, r.uniform(0.25, 0.5), r.uniform(0.15, 0.5)])
