# SPDX-License-Identifier: Apache-2.0
"""Which part and which plan scene `index` of a run has."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from stack_counter.sim.physics.collision import convex_pieces
from stack_counter.sim.physics.plans import (
    SETTINGS,
    PilePlan,
    draw_box_plan,
    draw_deep_plan,
    draw_mixed_plan,
    draw_rig_plan,
    draw_shallow_plan,
)
from stack_counter.sim.shapes import FAMILIES, Shape, make_shape

# Scenes of one part come one after the other: its convex pieces are made once.
SCENES_PER_SHAPE = 3
SCENES_PER_RIG = 9
# Most convex pieces in a scene: 300 parts of 24; of 100 scenes of real solids, 149 parts in the
# mean, each took one core some 11 s. In a pile of `part add` fewer: 64 piles should take two cores
# less than five minutes.
_MAX_PIECES, PART_PILE_PIECES = 7500, 3000
PLANS: dict[str, Callable[[np.random.Generator, Shape, int], PilePlan]] = {
    "shallow": draw_shallow_plan, "deep": draw_deep_plan, "mixed": draw_mixed_plan,
    "box": draw_box_plan}


@dataclass(frozen=True)
class Recipe:
    """What a run is made from.

    Attributes:
        plan: name in `PLANS`, or `rig`: several piles of one part in one container.
        library: parts to take; none for the training families.
    """

    plan: str = "mixed"
    library: Sequence[Shape] = ()

    def draw_shape(self, seed: int, index: int, attempt: int) -> Shape:
        """Draws the part of scene `index`; every other failed attempt takes another.

        Raises:
            ShapeError: the generator gave no solid.
        """
        change = attempt // 2
        if self.plan == "rig":
            index //= SCENES_PER_RIG
        if self.library:  # all of them in turn, in an order of the seed's
            order = np.random.default_rng([seed, change]).permutation(len(self.library))
            return self.library[order[index % len(order)]]
        number = index if self.plan == "rig" else index // SCENES_PER_SHAPE
        random = np.random.default_rng([seed, number, change])
        return make_shape(int(random.integers(2**31)), str(random.choice(list(FAMILIES))))

    def draw_plan(self, random: np.random.Generator, shape: Shape, pieces: int, seed: int,
                  index: int) -> PilePlan:
        """Draws a plan of scene `index` for a part that collides as so many convex pieces."""
        max_parts = min(SETTINGS.max_parts, _MAX_PIECES // pieces)
        if self.plan == "rig":
            rig_random = np.random.default_rng([seed, index // SCENES_PER_RIG, 0x416])
            return draw_rig_plan(random, rig_random, shape, max_parts)
        return PLANS[self.plan](random, shape, max_parts)


def max_simulated_parts(shape: Shape, max_pieces: int = _MAX_PIECES) -> int:
    """Most parts of a pile that the engine settles within seconds.

    Args:
        shape: the part.
        max_pieces: most convex pieces of the pile.

    Raises:
        ShapeError: the mesh of the part is no solid.
    """
    return min(SETTINGS.max_parts, max_pieces // len(convex_pieces(shape)))
