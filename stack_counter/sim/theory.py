"""The simulated piles against theory and literature, and hulls against decompositions.

    python -m stack_counter.sim.theory

Prints gamma of balls in the middle of a wide box (random packings of equal spheres: 0.56 loose to
0.64 close), of shaken cubes beside shaken balls, and by how much a pile of concave parts stands
too high if they collide as their hulls (the paper's way).
"""

from __future__ import annotations

import sys

import numpy as np
import trimesh

from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.shapes import Shape, make_shape, shape_from_mesh

_SIZE = 0.02  # of balls and cubes, m
_WIDE, _DEEP, _HIGH = 12.0, 5.0, 4.4  # the box of balls and cubes, and how high it is filled
_TRIES = 20
_CONCAVE = {"nut": 3, "bracket": 1, "tube": 7}  # family and seed


def pile(shape: Shape, width: float, depth: float, count: int, taps: int = 0,
         decompose: bool = True, seed: int = 0) -> Scene:
    """`count` parts in a square box of so many part sizes."""
    size = shape.part_size
    box = ContainerShape("bin", np.eye(4), (width * size, width * size, depth * size),
                         0.2 * size, 0.2 * size)
    plan = PilePlan(shape, box, np.array([0.95, 0.95]) * width * size, count, 0.4, 0.1, taps)
    for attempt in range(seed, seed + _TRIES):
        try:
            return simulate_pile(plan, np.random.default_rng(attempt), decompose=decompose)
        except SceneError as error:
            print(f"{shape.family}: {error}", file=sys.stderr)
    raise SceneError(f"{shape.family}: no try of {_TRIES} came to rest")


def ball() -> Shape:
    """A sphere of 320 faces; it collides as a hull of 64 corners of the same volume."""
    mesh = trimesh.creation.icosphere(2, _SIZE / 2)
    return shape_from_mesh(mesh.vertices, mesh.faces, "ball", part_size=_SIZE)


def cube() -> Shape:
    """A cube."""
    mesh = trimesh.creation.box([_SIZE] * 3)
    return shape_from_mesh(mesh.vertices, mesh.faces, "cube")


def main() -> int:
    """Prints the figures."""
    area = _WIDE**2
    for name, shape, taps in (("balls, poured", ball(), 0), ("balls, shaken", ball(), 60),
                              ("cubes, shaken", cube(), 60)):
        count = int(area * _HIGH * 0.6 * shape.part_size**3 / shape.unit_volume)
        truth = pile(shape, _WIDE, _DEEP, count, taps).truth
        print(f"{name}: {truth.count} parts, gamma in the middle {truth.gamma_center:.3f}, "
              f"under the surface {truth.gamma:.3f}", flush=True)
    for family, seed in _CONCAVE.items():
        shape = make_shape(seed, family)
        v = [pile(shape, 6, 8, 150, decompose=exact, seed=seed).truth.stack_volume
             for exact in (True, False)]
        print(f"{family} (convexity {shape.convexity:.2f}): hulls stand {v[1] / v[0] - 1:+.1%} "
              "higher than decompositions", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
