# SPDX-License-Identifier: Apache-2.0
"""Last layers adapted to one part's piles."""

from dataclasses import replace

import numpy as np
import pytest
from kits.known_parts import simulated_readings

from stack_counter.teaching.simulated_piles import Pile
from stack_counter.teaching.tuning import tune


def with_hidden(misses_of, size=12):
    """Piles whose last layers, of two members, show what the network misses, or do not."""
    random, out = np.random.default_rng(2), []
    for pile in simulated_readings(60):
        hidden = random.normal(size=(2, size))
        estimated = pile.reading.log_gamma_counted - misses_of(random, hidden)
        seen = replace(pile, last_layer_input=hidden,
                       reading=replace(pile.reading, log_gamma_estimated=estimated))
        out.append(Pile(seen, None))
    return out


def test_what_the_last_layers_show_is_learnt():
    tuning = tune(with_hidden(lambda random, z: 0.1 * z[0, 0] - 0.05 * z[1, 3] + 0.2))
    assert tuning.weight.shape == (2, 12)
    assert tuning.weight[0, 0] / 2 == pytest.approx(0.1, abs=0.03), "members are averaged"
    assert tuning.weight[1, 3] / 2 == pytest.approx(-0.05, abs=0.03)
    assert tuning.tuned < 0.5 * tuning.joined and tuning.better
    shift = [
        a.arc.reading.log_gamma_estimated - a.arc.reading.log_gamma_counted for a in tuning.piles
    ]
    assert np.abs(shift).mean() < 0.02, "each pile by layers that have not seen it"


def test_what_they_do_not_show_is_not_claimed():
    tuning = tune(with_hidden(lambda random, z: random.normal(0, 0.1)))
    assert tuning.tuned > 0.9 * tuning.joined


def test_what_one_kind_of_scans_loses_the_other_does_not_make_good():
    around = with_hidden(lambda random, z: 0.1 * z[0, 0])
    both = [Pile(p.arc, replace(p.arc, last_layer_input=-p.arc.last_layer_input)) for p in around]
    assert not tune(both).better, "from one side the same layers mean the opposite"
