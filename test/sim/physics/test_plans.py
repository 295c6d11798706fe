# SPDX-License-Identifier: Apache-2.0
"""Plans: friction and taps are drawn as reality has them."""

import numpy as np
import pytest

from stack_counter.sim.physics.plans import SETTINGS
from stack_counter.sim.physics.recipes import PLANS, Recipe
from stack_counter.sim.shapes import make_shape

BLOCK = make_shape(0, "block")


@pytest.mark.parametrize("plan", [*PLANS, "rig"])
def test_the_logarithm_of_the_friction_is_uniform(plan):
    recipe = Recipe(plan, (BLOCK,))
    plans = [recipe.draw_plan(np.random.default_rng(i), BLOCK, 1, 7, i * 9) for i in range(400)]
    low, high = np.log(SETTINGS.friction)
    share = (np.log([p.friction for p in plans]) - low) / (high - low)
    assert share.min() >= 0 and share.max() <= 1
    # Deciles of a uniform distribution, within four standard deviations of 400 draws
    np.testing.assert_allclose(np.quantile(share, np.linspace(0.1, 0.9, 9)),
                               np.linspace(0.1, 0.9, 9), atol=4 * 0.5 / np.sqrt(400))


@pytest.mark.parametrize("plan", ["shallow", "deep", "mixed", "rig"])
def test_a_tenth_of_the_piles_is_shaken_twenty_times_and_more(plan):
    recipe = Recipe(plan, (BLOCK,))
    taps = np.array([recipe.draw_plan(np.random.default_rng(i), BLOCK, 1, 7, i).taps
                     for i in range(500)])
    assert 0.05 < (taps > 0).mean() < 0.16
    assert taps[taps > 0].min() >= 20 and taps.max() <= 60


def test_a_pile_of_hollow_parts_is_a_pile():
    recipe = Recipe("deep", (BLOCK,))
    counts = [recipe.draw_plan(np.random.default_rng(i), BLOCK, 24, 7, i).count
              for i in range(100)]
    assert 150 < max(counts) <= 7500 // 24
