# SPDX-License-Identifier: Apache-2.0
"""Families of irregular outlines and clusters."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, JoinType, Manifold

from stack_counter.sim.shapes.solids import (
    bar,
    box,
    cylinder,
    direction,
    largest,
    polar,
    polygon,
    rotated,
    union,
)


def blobs(random: np.random.Generator) -> Manifold:
    """A chain or cluster of overlapping balls."""
    chain = random.random() < 0.5
    at, radii = [np.zeros(3)], [random.uniform(0.15, 0.3)]
    for _ in range(random.integers(1, 6)):
        i = len(at) - 1 if chain else int(random.integers(len(at)))
        radius = random.uniform(0.13, 0.3)
        reach = random.uniform(0.6, 0.85) * (radii[i] + radius)
        at.append(at[i] + direction(random) * reach)
        radii.append(radius)
    return union([Manifold.sphere(s, 16).translate(p) for s, p in zip(radii, at, strict=True)])


def csg(random: np.random.Generator) -> Manifold:
    """Three to six primitives at random places, added or cut away."""

    def primitive() -> Manifold:
        a, b, c = random.uniform(0.2, 0.8, 3)
        kind = int(random.integers(3))
        return rotated(
            [box(a, b, c), cylinder(a, b / 2, 20), Manifold.sphere(a / 2, 16)][kind], random
        )

    solid = primitive()
    for _ in range(random.integers(2, 6)):
        low, high = np.split(np.array(solid.bounding_box()), 2)
        other = primitive().translate(low + (high - low) * random.uniform(0.1, 0.9, 3))
        rest = largest(solid - other)
        keep = random.random() < 0.5 and rest.volume() > 0.4 * solid.volume()
        solid = rest if keep else solid + other
    return largest(solid)


def _ragged(random: np.random.Generator) -> CrossSection:
    """A polygon about the origin with corners near and far."""
    n = int(random.integers(5, 12))
    angles = (np.arange(n) + random.uniform(-0.35, 0.35, n)) * 2 * np.pi / n
    return polygon(polar(0.5 * random.uniform(0.25, 1, n), angles)).scale(
        [1, random.uniform(0.6, 1)]
    )


def _joined(random: np.random.Generator) -> CrossSection:
    """Two to four strips and discs, each upon the outline of those before."""
    outline = CrossSection.square([1, random.uniform(0.12, 0.5)], True)
    for _ in range(random.integers(1, 4)):
        wide, high = random.uniform(0.15, 0.7, 2)
        other = CrossSection.square([wide, high], True) if random.random() < 0.6 \
            else CrossSection.circle(wide / 2, 20)
        corners = np.vstack(outline.to_polygons())
        outline += other.rotate(random.uniform(0, 360)).translate(0.9 * random.choice(corners))
    return outline


def extruded(random: np.random.Generator) -> Manifold:
    """A random outline, often concave, with depth; some with a hole or taper."""
    outline = _ragged(random) if random.random() < 0.5 else _joined(random)
    if random.random() < 0.4:
        outline = outline.offset(0.05, JoinType.Round, 2, 16)
    if random.random() < 0.3:
        outline -= CrossSection.circle(random.uniform(0.04, 0.1), 12)
    # Shrunk and grown again, it keeps nothing thinner than 0.06.
    outline = outline.offset(-0.03, JoinType.Miter).offset(0.03, JoinType.Miter)
    outline = max(outline.decompose(), key=CrossSection.area)
    top = random.uniform(0.6, 1) if random.random() < 0.3 else 1
    return outline.extrude(random.uniform(0.08, 1), 0, 0, [top, top])


def revolved(random: np.random.Generator) -> Manifold:
    """A turned part of two to six steps or tapers, solid or bored through."""
    steps = int(random.integers(2, 7))
    radii = random.uniform(0.15, 0.42) * random.uniform(0.45, 1, steps)  # no deep groove: a pulley
    z = np.linspace(0, 1, steps + 1) ** random.uniform(0.7, 1.4)
    if random.random() < 0.5:
        side = np.stack([radii.repeat(2), np.stack([z[:-1], z[1:]], axis=1).ravel()], axis=1)
    else:
        side = np.stack([radii, np.linspace(0, 1, steps)], axis=1)
    solid = polygon(np.vstack([[0, 0], side, [0, 1]])).revolve(24)
    bore = radii.min() - random.uniform(0.045, 0.1)
    return solid - cylinder(3, bore, 20) if bore > 0.03 and random.random() < 0.6 else solid


def tetrapod(random: np.random.Generator) -> Manifold:
    """Four or five arms in space: a caltrop."""
    up = np.array([0, 0, 1.0])
    flat = np.hstack([polar(np.ones(3), np.arange(3) * 2 * np.pi / 3), np.zeros((3, 1))])
    arms = np.vstack([up, -up, flat] if random.random() < 0.3 else [up, flat * 0.943 - up / 3])
    root, tip = random.uniform(0.08, 0.2), random.uniform(0.035, 0.12)
    return union([bar(np.zeros(3), a * random.uniform(0.35, 0.5), root, tip, 12) for a in arms])


def burr(random: np.random.Generator) -> Manifold:
    """A ball or block with studs that stand out all around."""
    core = random.uniform(0.2, 0.34)
    stud = cylinder(0.5, random.uniform(0.06, 0.5 * core), int(random.choice([4, 6, 10])))
    studs = [rotated(stud.translate([0, 0, 0.25]), random) for _ in range(random.integers(3, 9))]
    return union([Manifold.sphere(core, 20), *studs])
