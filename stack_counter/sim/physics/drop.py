# SPDX-License-Identifier: Apache-2.0
"""From a plan to a scene at rest, checked; and scene `index` of a run."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass

import numpy as np

from stack_counter.sim.physics import plans
from stack_counter.sim.physics.collision import convex_pieces
from stack_counter.sim.physics.engine import PileSimulation
from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.physics.true_overlap import count_crossings
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.shapes import ShapeError


@dataclass(frozen=True)
class DropSettings:
    """When a pile is refused; chosen.

    Attributes:
        max_penetration: deepest overlap of any two bodies, in part sizes.
        max_tries: number of plans drawn for a scene before the run gives up.
    """

    max_penetration: float = 0.02
    max_tries: int = 30


SETTINGS = DropSettings()


def make_scene(seed: int, index: int, recipe: Recipe, failed_tries: Counter[str]) -> Scene:
    """Makes scene `index` of a run: depends on recipe, seed and index alone, retries included.

    Args:
        seed: seed of the run.
        index: number of the scene.
        recipe: what the run is made from.
        failed_tries: counts the reasons of failed tries in place.

    Raises:
        SceneError: no try came to rest.
    """
    for attempt in range(SETTINGS.max_tries):
        random = np.random.default_rng([seed, index, attempt])
        try:
            shape = recipe.draw_shape(seed, index, attempt)
            plan = recipe.draw_plan(random, shape, len(convex_pieces(shape)), seed, index)
            return simulate_pile(plan, random, seed, index)
        except (SceneError, ShapeError) as error:
            failed_tries[str(error).split(":")[0]] += 1
    raise SceneError(f"scene {index} of seed {seed} failed {SETTINGS.max_tries} times: "
                     f"{dict(failed_tries)}")


def simulate_pile(plan: PilePlan, random: np.random.Generator, seed: int = 0, index: int = 0,
                  decompose: bool = True) -> Scene:
    """Pours, shakes and settles one plan.

    Args:
        plan: what to drop where.
        random: draws attitudes, places and taps.
        seed: seed that the scene will be named by.
        index: number that it will be named by.
        decompose: False collides concave parts as hulls, as the paper does.

    Raises:
        SceneError: it does not rest, parts penetrate, walls have crossed, or too few stay.
    """
    size = plan.shape.part_size
    if min(plan.container.inner_size_m[:2]) < size:
        raise SceneError(f"container too small: {plan.container.inner_size_m} m inside; expected "
                         f"at least the part's {size:.4f} m")
    # Simulate in part sizes
    pile = PileSimulation(plan, convex_pieces(plan.shape, decompose), random)
    pile.pour()
    pile.shake()
    pile.settle()
    # Refuse overlapping parts
    overlap = pile.deepest_overlap()
    if overlap > SETTINGS.max_penetration:
        raise SceneError(f"penetration: {overlap:.3f} of the part size; expected at most "
                         f"{SETTINGS.max_penetration}")
    # Keep the parts over the opening, in metres
    poses = pile.poses() * [size, size, size, 1, 1, 1, 1]
    poses = poses[plan.container.is_over_opening(poses[:, :3]) & (poses[:, 2] > 0)]
    fewest = plans.SETTINGS.min_parts
    if len(poses) < min(fewest, plan.count):
        raise SceneError(f"too few: {len(poses)} parts stayed; expected {fewest} or more")
    # Refuse walls through each other, which the engine's pieces may not show
    if crossings := count_crossings(plan.shape, poses):
        raise SceneError(f"crossed walls: {crossings} pairs of parts go through each other; "
                         "expected none")
    # What is rendered and measured is what is stored.
    return Scene(seed, index, plan.shape, plan.container, unpack_poses(pack_poses(poses)),
                 plan.friction, plan.restitution, plan.taps)
