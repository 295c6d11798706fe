# SPDX-License-Identifier: Apache-2.0
"""Recipes of small scenes. They live here because worker processes import them by name."""

import numpy as np

from stack_counter.sim.physics.plans import PilePlan
from stack_counter.sim.physics.recipes import Recipe
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.scene import SceneError


class Few(Recipe):
    """A dozen blocks in a small bin."""

    def draw_plan(self, random, shape, pieces, seed, index):
        size = shape.part_size
        inner = tuple(random.uniform(3, 3.5, 3) * size)
        box = ContainerShape("bin", np.eye(4), inner, 0.1 * size, 0.1 * size)
        return PilePlan(shape, box, 0.7 * np.array(inner[:2]), int(random.integers(8, 14)),
                        taps=int(random.integers(2)))


class Hopeless(Recipe):
    """No scene can be made."""

    def draw_plan(self, random, shape, pieces, seed, index):
        raise SceneError("container too small: none would do")
