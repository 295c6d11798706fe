# SPDX-License-Identifier: Apache-2.0
"""How heaps differ from piles in containers, on figures that are made up."""

import numpy as np
import pytest

from stack_counter.train.heap_spread import PileFigures, heap_differences


def test_the_difference_of_heaps_is_found_beside_parts_fill_and_friction():
    random, piles = np.random.default_rng(0), []
    for part in range(60):
        level = random.normal(-0.7, 0.3)
        for number in range(3):
            is_heap = number == part % 3
            x = random.uniform(0, 1, 4)
            log_gamma = level + x @ (0.4, -0.3, -0.2, 0.0) + 0.12 * is_heap
            log_gamma += random.normal(0, 0.02)
            piles.append(PileFigures(("nut", part), is_heap, log_gamma, tuple(x), 2.0, 0.3))
    differences, deviation = heap_differences(piles)
    assert len(differences) == 60 and differences.mean() == pytest.approx(0.12, abs=0.01)
    assert deviation == pytest.approx(0.02, rel=0.3)
