# SPDX-License-Identifier: Apache-2.0
"""The simulated piles against theory and literature, and hulls against decompositions.

    python -m stack_counter.sim.theory

Prints gamma of balls in the middle of a wide box (random packings of equal spheres: 0.56 loose to
0.64 close), of shaken cubes beside shaken balls, and by how much a pile of concave parts stands
too high if they collide as their hulls (the paper's way).
"""

from __future__ import annotations

import sys
from dataclasses import dataclass, field

import numpy as np
import trimesh

from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.shapes import Shape, make_shape, shape_from_mesh


@dataclass(frozen=True)
class TheorySettings:
    """The piles that are compared; chosen. Lengths are in part sizes, if no unit is named.

    Attributes:
        part_size_m: size of balls and cubes.
        width, depth, height: box of balls and cubes, and how high it is filled.
        solid_share: gamma that is expected where a number of balls or cubes is chosen.
        taps: taps of a pile that is shaken.
        concave_width, concave_depth: box of concave parts.
        concave_count: number of concave parts.
        concave_parts: families and seeds of concave parts.
        wall: thickness of walls and floor.
        friction, restitution: of all contacts.
        column: side of the poured column over that of the box.
        max_tries: seeds tried for a pile.
    """

    part_size_m: float = 0.02
    width: float = 12.0
    depth: float = 5.0
    height: float = 4.4
    solid_share: float = 0.6
    taps: int = 60
    concave_width: float = 6
    concave_depth: float = 8
    concave_count: int = 150
    concave_parts: dict[str, int] = field(
        default_factory=lambda: {"nut": 3, "bracket": 1, "tube": 7})
    wall: float = 0.2
    friction: float = 0.4
    restitution: float = 0.1
    column: float = 0.95
    max_tries: int = 20


SETTINGS = TheorySettings()


def simulate_box(shape: Shape, width: float, depth: float, count: int, taps: int = 0,
                 decompose: bool = True, seed: int = 0) -> Scene:
    """Simulates `count` parts in a square box of so many part sizes.

    Raises:
        SceneError: no try came to rest.
    """
    size = shape.part_size
    box = ContainerShape("bin", np.eye(4), (width * size, width * size, depth * size),
                         SETTINGS.wall * size, SETTINGS.wall * size)
    column = np.array([SETTINGS.column, SETTINGS.column]) * width * size
    plan = PilePlan(shape, box, column, count, SETTINGS.friction, SETTINGS.restitution, taps)
    for attempt in range(seed, seed + SETTINGS.max_tries):
        try:
            return simulate_pile(plan, np.random.default_rng(attempt), decompose=decompose)
        except SceneError as error:
            print(f"{shape.family}: {error}", file=sys.stderr)
    raise SceneError(f"{shape.family}: no try of {SETTINGS.max_tries} came to rest")


def make_ball() -> Shape:
    """A sphere of 320 faces; it collides as a hull of 64 corners of the same volume."""
    mesh = trimesh.creation.icosphere(2, SETTINGS.part_size_m / 2)
    return shape_from_mesh(mesh.vertices, mesh.faces, "ball", part_size=SETTINGS.part_size_m)


def make_cube() -> Shape:
    """A cube of the same size as the ball."""
    mesh = trimesh.creation.box([SETTINGS.part_size_m] * 3)
    return shape_from_mesh(mesh.vertices, mesh.faces, "cube")


def main() -> int:
    """Prints the figures."""
    # Convex parts: gamma in the middle of the box and under the surface
    room = SETTINGS.width**2 * SETTINGS.height * SETTINGS.solid_share
    for name, shape, taps in (("balls, poured", make_ball(), 0),
                              ("balls, shaken", make_ball(), SETTINGS.taps),
                              ("cubes, shaken", make_cube(), SETTINGS.taps)):
        count = int(room * shape.part_size**3 / shape.unit_volume)
        truth = simulate_box(shape, SETTINGS.width, SETTINGS.depth, count, taps).truth
        print(f"{name}: {truth.count} parts, gamma in the middle {truth.gamma_center:.3f}, "
              f"under the surface {truth.gamma:.3f}", flush=True)
    # Concave parts: V of the same pile by decompositions and by hulls
    for family, seed in SETTINGS.concave_parts.items():
        shape = make_shape(seed, family)
        exact, hulls = (
            simulate_box(shape, SETTINGS.concave_width, SETTINGS.concave_depth,
                         SETTINGS.concave_count, decompose=decompose, seed=seed).truth
            for decompose in (True, False))
        print(f"{family} (convexity {shape.convexity:.2f}): hulls stand "
              f"{hulls.stack_volume / exact.stack_volume - 1:+.1%} higher than decompositions",
              flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
