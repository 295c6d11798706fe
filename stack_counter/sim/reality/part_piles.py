# SPDX-License-Identifier: Apache-2.0
"""Piles as `part add` draws them, any friction and fill, beside what was measured of the part."""

from __future__ import annotations

import zlib
from dataclasses import dataclass

import numpy as np

from stack_counter.sim.physics import plans
from stack_counter.sim.physics.container_draws import draw_deep_container
from stack_counter.sim.physics.drop import simulate_pile
from stack_counter.sim.physics.recipes import PART_PILE_PIECES, max_simulated_parts
from stack_counter.sim.reality.experiments import EXPERIMENTS, Experiment, counted_volume
from stack_counter.sim.reality.piles import round_vessel
from stack_counter.sim.scenes.scene import SceneError
from stack_counter.sim.shapes import Shape


@dataclass(frozen=True)
class PartPilesSettings:
    """Which parts, and how many piles; chosen.

    Attributes:
        names: experiments whose part is taken.
        piles: simulated piles of each.
        max_tries: plans drawn for a pile.
    """

    names: tuple[str, ...] = ("dice: cube", "Raschig ring, metal, 25 mm", "LEGO 2 x 4, a tub")
    piles: int = 8
    max_tries: int = 12


SETTINGS = PartPilesSettings()


def describe_part_piles(name: str) -> str:
    """A sentence with the spread of the piles' shares and what was measured.

    Raises:
        SceneError: a pile did not come to rest in any try.
    """
    measured = [e for e in EXPERIMENTS if e.name == name]
    shape = measured[0].part()
    shares = [_draw_share(measured[0], shape, index) for index in range(SETTINGS.piles)]
    values = " and ".join(f"{e.measured_share(shape):.3f} ({e.pour})" for e in measured)
    return f"{name}: {len(shares)} piles as `part add` draws them fill {np.mean(shares):.3f} of " \
           f"their volume ({min(shares):.3f} to {max(shares):.3f}); measured {values}."


def _draw_share(experiment: Experiment, shape: Shape, index: int) -> float:
    """The share of the volume under the surface, as the experiment's, of one pile."""
    max_parts = max_simulated_parts(shape, PART_PILE_PIECES)
    stream, last = zlib.crc32(experiment.name.encode()), ""
    for attempt in range(SETTINGS.max_tries):
        random = np.random.default_rng([stream, index, attempt])
        container = round_vessel(experiment.tub, experiment.tub.depth_m, shape) \
            if experiment.tub else draw_deep_container(random, shape, max_parts)
        plan = plans.draw_plan_in_container(random, shape, container, plans.FRICTION, max_parts)
        try:
            gamma = simulate_pile(plan, random).truth.gamma
            return gamma * counted_volume(experiment, shape) / shape.unit_volume
        except SceneError as error:
            last = str(error)
    raise SceneError(f"{experiment.name}: no try of {SETTINGS.max_tries} came to rest: {last}")
