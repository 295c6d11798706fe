# SPDX-License-Identifier: Apache-2.0
"""Piles of one part as two regressions: what was put in comes out."""

import numpy as np
import pytest
from kits.known_parts import simulated_readings

from stack_counter.counting import conformal_quantile
from stack_counter.errors import PartError
from stack_counter.parts.gamma_model import Reading
from stack_counter.teaching.model_fit import fit_model


def test_the_coefficients_the_noise_and_the_friction_come_out():
    model = fit_model(simulated_readings(400))
    assert model.coefficients[0] == pytest.approx([-0.6, 0.3, -1.0], abs=0.08)
    # Half of what is left is taken to be the rig's own: its container, and V's error by it.
    assert np.sqrt(np.diag(model.noise)) == pytest.approx([0.03 / np.sqrt(2), 0.05], rel=0.1)
    assert model.friction == pytest.approx([-0.2, -0.2], abs=0.03)
    assert model.volume_variance == pytest.approx(0.02**2) and model.source == "piles"
    gamma, std = model.gamma_at(3.0, 6.0)
    assert gamma == pytest.approx(np.exp(-0.6 + 0.3 / 3.5 - 1 / 6), rel=0.01)
    # Over all rigs it is as uncertain as the piles and their friction make it.
    assert std / gamma == pytest.approx(np.hypot(0.03, 0.2 * 0.5 / np.sqrt(12)), rel=0.1)


def test_few_piles_leave_more_unknown():
    few, many = (fit_model(simulated_readings(n)).gamma_at(10.0, 20.0)[1] for n in (32, 400))
    assert few > many


def test_scores_are_of_piles_left_out_and_hold_the_truth_as_often_as_they_say():
    hits = []
    for seed in range(4):
        model = fit_model(simulated_readings(64, seed))
        assert len(model.scores) == 64 and (np.diff(model.scores) >= 0).all()
        low, high = (conformal_quantile(model.scores, share) for share in (0.05, 0.95))
        for pile in simulated_readings(100, seed=10 + seed):
            scan = Reading(
                pile.reading.height, pile.reading.width, pile.reading.log_gamma_estimated
            )
            posterior = model.posterior(scan)
            off = (pile.reading.log_gamma_counted - posterior.mean) / np.hypot(
                posterior.std, pile.volume_std
            )
            hits.append(low <= off <= high)
    assert 0.86 < np.mean(hits) < 0.96


def test_a_few_missed_containers_do_not_move_it_but_widen_the_scores():
    clean, dirty = fit_model(simulated_readings(64)), fit_model(simulated_readings(64, far=4))
    assert dirty.coefficients[0] == pytest.approx(clean.coefficients[0], abs=0.15)
    assert np.sqrt(dirty.noise[0, 0]) < 0.04
    assert dirty.scores[-4:].min() > 8 and clean.scores.max() < 5


def test_too_few_piles_are_refused():
    with pytest.raises(PartError, match="20 piles gave a scan; expected at least 24"):
        fit_model(simulated_readings(20))
