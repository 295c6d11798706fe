"""From a plan to a scene at rest, checked; and scene `index` of a run."""

from __future__ import annotations

from collections import Counter

import numpy as np

from stack_counter.sim.physics.collision import convex_pieces
from stack_counter.sim.physics.engine import PileSimulation
from stack_counter.sim.physics.plans import MIN_PARTS, PilePlan
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene, SceneError
from stack_counter.sim.shapes import ShapeError

MAX_PENETRATION = 0.02  # of the part size
_TRIES = 30


def make_scene(seed: int, index: int, recipe: Recipe, skipped: Counter[str]) -> Scene:
    """Scene `index` of a run: depends on recipe, seed and index alone, retries included.

    Args:
        skipped: counts the reasons of failed tries in place.

    Raises:
        SceneError: no try came to rest.
    """
    for attempt in range(_TRIES):
        random = np.random.default_rng([seed, index, attempt])
        try:
            shape = recipe.shape(seed, index, attempt)
            plan = recipe.draw(random, shape, len(convex_pieces(shape)), seed, index)
            return simulate_pile(plan, random, seed, index)
        except (SceneError, ShapeError) as error:
            skipped[str(error).split(":")[0]] += 1
    raise SceneError(f"scene {index} of seed {seed} failed {_TRIES} times: {dict(skipped)}")


def simulate_pile(plan: PilePlan, random: np.random.Generator, seed: int = 0, index: int = 0,
                  decompose: bool = True) -> Scene:
    """Simulates one plan.

    Args:
        decompose: False collides concave parts as hulls, as the paper does.

    Raises:
        SceneError: it does not rest, parts penetrate, or too few stay.
    """
    size = plan.shape.part_size
    if min(plan.container.inner_size_m[:2]) < size:
        raise SceneError(f"container too small: {plan.container.inner_size_m} m inside; expected "
                         f"at least the part's {size:.4f} m")
    pile = PileSimulation(plan, convex_pieces(plan.shape, decompose), random)
    pile.pour()
    pile.shake()
    pile.settle()
    deep = pile.deepest_overlap()
    if deep > MAX_PENETRATION:
        raise SceneError(f"penetration: {deep:.3f} of the part size; expected at most "
                         f"{MAX_PENETRATION}")
    poses = pile.poses() * [size, size, size, 1, 1, 1, 1]
    poses = poses[plan.container.is_over_opening(poses[:, :3]) & (poses[:, 2] > 0)]
    if len(poses) < min(MIN_PARTS, plan.count):
        raise SceneError(f"too few: {len(poses)} parts stayed; expected {MIN_PARTS} or more")
    # What is rendered and measured is what is stored.
    return Scene(seed, index, plan.shape, plan.container, unpack_poses(pack_poses(poses)),
                 plan.friction, plan.restitution, plan.taps)
