# SPDX-License-Identifier: Apache-2.0
"""By how much a pile stands too high if its concave parts collide as their hulls.

The paper simulates so; here hulls are taken for convex parts alone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.reality.experiments import POURED
from stack_counter.sim.reality.piles import friction_of
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.shapes import Shape, make_shape


@dataclass(frozen=True)
class NestingSettings:
    """The piles that are compared; chosen. Lengths are in part sizes.

    Attributes:
        parts: families and seeds of concave parts.
        count: number of parts.
        width, depth: box that they are poured into.
        wall: thickness of walls and floor.
        column: side of the poured column over that of the box.
        max_tries: seeds tried for a pile.
    """

    parts: Mapping[str, int] = field(default_factory=lambda: {"nut": 3, "bracket": 1, "tube": 7})
    count: int = 150
    width: float = 6.0
    depth: float = 8.0
    wall: float = 0.2
    column: float = 0.95
    max_tries: int = 20


SETTINGS = NestingSettings()


def describe_nesting(family: str) -> str:
    """A sentence with the part's convexity and the relative excess of V by hulls.

    Raises:
        SceneError: no try came to rest.
    """
    shape = make_shape(SETTINGS.parts[family], family)
    exact, hulls = (_stack_volume(shape, decompose) for decompose in (True, False))
    return f"{family} (convexity {shape.convexity:.2f}): a pile of hulls stands " \
           f"{hulls / exact - 1:+.1%} higher than one of decompositions."


def _stack_volume(shape: Shape, decompose: bool) -> float:
    """V of the first pile that comes to rest, m3."""
    size, last = shape.part_size, ""
    sides = np.array([SETTINGS.width, SETTINGS.width, SETTINGS.depth]) * size
    box = ContainerShape("bin", np.eye(4), (sides[0], sides[1], sides[2]), SETTINGS.wall * size,
                         SETTINGS.wall * size)
    plan = PilePlan(shape, box, SETTINGS.column * sides[:2], SETTINGS.count, friction_of(POURED))
    for seed in range(SETTINGS.max_tries):
        try:
            scene = simulate_pile(plan, np.random.default_rng(seed), decompose=decompose)
            return scene.truth.stack_volume
        except SceneError as error:
            last = str(error)
    raise SceneError(f"{shape.family}: no try of {SETTINGS.max_tries} came to rest: {last}")
