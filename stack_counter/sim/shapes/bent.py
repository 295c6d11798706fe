# SPDX-License-Identifier: Apache-2.0
"""Families of bent wire, pipe, strip and sheet."""

from __future__ import annotations

import numpy as np
from manifold3d import CrossSection, Manifold

from stack_counter.sim.shapes.solids import bar, box, direction, polygon, sweep, union


def elbow(random: np.random.Generator) -> Manifold:
    """A bent rod or pipe of a round or square section."""
    thin = random.uniform(0.08, 0.26)
    sides = int(random.choice([4, 16, 16]))
    section = CrossSection.circle(thin, sides)
    if random.random() < 0.6:
        section -= CrossSection.circle(thin * random.uniform(0.4, 0.7), sides)
    bend, turn = random.uniform(1.15, 3) * thin, random.uniform(45, 180)
    return section.translate([bend, 0]).revolve(int(turn / 10), turn)


def c_ring(random: np.random.Generator) -> Manifold:
    """An open ring: a circlip, a clamp, a split sleeve."""
    wall = random.uniform(0.05, 0.16)
    section = CrossSection.circle(wall / 2, 10) if random.random() < 0.35 \
        else CrossSection.square([wall, random.uniform(0.05, 0.8)], True)
    return section.translate([0.5 - wall / 2, 0]).revolve(36, random.uniform(210, 335))


def arch(random: np.random.Generator) -> Manifold:
    """A part of a pipe's wall: a tile, a bearing shell, a segment."""
    wall, outer = random.uniform(0.06, 0.3), random.uniform(0.5, 1)
    section = CrossSection.square([wall, random.uniform(0.15, 1)], True)
    return section.translate([outer - wall / 2, 0]).revolve(36, random.uniform(40, 150))


def helix(random: np.random.Generator) -> Manifold:
    """A coil spring of 1.5 to 6 turns, some conical."""
    turns, wire = random.uniform(1.5, 6), random.uniform(0.03, 0.09)
    radius, pitch = random.uniform(max(0.13, 2.2 * wire), 0.45), wire * random.uniform(2.4, 5)
    t = np.linspace(0, turns, int(13 * turns))
    reach = radius * (1 - random.uniform(0, 0.5) * (random.random() < 0.3) * t / turns)
    angle = 2 * np.pi * t
    path = np.stack([reach * np.cos(angle), reach * np.sin(angle), pitch * t], axis=1)
    return sweep(CrossSection.circle(wire, 7), path)


def ribbon(random: np.random.Generator) -> Manifold:
    """A twisted strip or bar."""
    width = random.uniform(0.12, 0.45)
    turn = random.choice([-1, 1]) * random.uniform(
        1.2, min(7, 2 / width)
    )  # radians; more would thin it
    strip = box(width, random.uniform(0.05, 0.06 + width / 2), 1).refine_to_length(0.09)

    def twist(p: np.ndarray) -> np.ndarray:
        (x, y, z), c, s = p.T, np.cos(turn * p[:, 2]), np.sin(turn * p[:, 2])
        return np.stack([c * x - s * y, s * x + c * y, z], axis=1)

    return strip.warp_batch(twist)


def _track(*legs: tuple[float, float]) -> np.ndarray:
    """(n, 3) path in the plane z = 0 from legs (length, degrees turned)."""
    steps = [(length / n, np.radians(turn) / n) for length, turn in legs
             for n in [max(2, int(abs(turn) / 14))] for _ in range(n)]
    lengths, turns = np.array(steps).T
    heading = np.cumsum(turns) - turns / 2
    moves = np.stack([lengths * np.cos(heading), lengths * np.sin(heading), 0 * heading], axis=1)
    return np.vstack([np.zeros(3), np.cumsum(moves, axis=0)])


def hook(random: np.random.Generator) -> Manifold:
    """A J, S or eye hook of round wire or flat strip."""
    wire, turn, long = (
        random.uniform(0.03, 0.07),
        random.uniform(150, 230),
        random.uniform(0.2, 0.8),
    )
    bend, eye = random.uniform(3.2, 6, 2) * wire
    arc = bend * np.radians(turn)
    kind = int(random.integers(3))
    path = [lambda: _track((long, 0), (arc, turn)),
            lambda: _track((arc, turn), (long / 2, 0), (eye * np.radians(turn), -turn)),
            lambda: _track((eye * np.radians(270), -270), (long / 2, 0), (arc, turn))][kind]()
    section = CrossSection.circle(wire, 8) if random.random() < 0.7 \
        else CrossSection.square([wire * 1.4, random.uniform(0.1, 0.3)], True)
    return sweep(section, path)


def link(random: np.random.Generator) -> Manifold:
    """A chain link: a ring pulled long, some twisted."""
    wire, gap = random.uniform(0.05, 0.12), random.uniform(0.05, 0.2)
    ring = CrossSection.circle(wire, 10).translate([gap + wire, 0]).revolve(24)
    half = random.uniform(0.1, 0.5)
    twist = random.uniform(0.2, 0.6) * (random.random() < 0.3)

    def pull(p: np.ndarray) -> np.ndarray:
        x = p[:, 0] + half * np.clip(p[:, 0] / gap * 3, -1, 1)
        c, s = np.cos(twist * x / half), np.sin(twist * x / half)
        return np.stack([x, c * p[:, 1] - s * p[:, 2], s * p[:, 1] + c * p[:, 2]], axis=1)

    return ring.warp_batch(pull)


def crank(random: np.random.Generator) -> Manifold:
    """A rod bent sharply in space, two to four legs."""
    radius, at = random.uniform(0.05, 0.1), [np.zeros(3)]
    for _ in range(random.integers(2, 5)):
        at.append(at[-1] + direction(random) * random.uniform(0.3, 0.7))
    return union([bar(a, b, radius, radius, 10) for a, b in zip(at, at[1:], strict=False)])


def saddle(random: np.random.Generator) -> Manifold:
    """A bowed sheet: a crisp, a dish or a roof tile."""
    width, thick = random.uniform(0.4, 1), random.uniform(0.06, 0.14)
    bow = random.uniform(-0.9, 0.9, 2)
    sheet = CrossSection.circle(0.5, 24).extrude(thick, 0) if random.random() < 0.5 \
        else CrossSection.square([1, 1], True).extrude(thick)
    sheet = sheet.refine_to_length(0.17).scale([1, width, 1])
    return sheet.warp_batch(lambda p: p + [0, 0, 1] * (p[:, :2]**2 @ bow)[:, None])


def corrugated(random: np.random.Generator) -> Manifold:
    """A sheet bent in three to six waves, round or sharp (one would be a Z or U)."""
    waves, thick = int(random.integers(3, 7)), random.uniform(0.045, 0.08)
    height = random.uniform(0.25, 0.8) / waves
    x = np.linspace(0, 1, waves * int(random.choice([2, 8])) + 1)
    y = height / 2 * np.cos(2 * np.pi * waves * x)
    slope = np.hypot(1, np.pi * height * waves)  # keeps the slopes thick enough
    low = np.stack([x, y], axis=1)
    outline = np.vstack([low, (low + [0, thick * slope])[::-1]])
    return polygon(outline).extrude(random.uniform(0.15, 1))
