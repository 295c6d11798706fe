# SPDX-License-Identifier: Apache-2.0
"""One part's Gaussian: what is joined by which weight, and what a counted scan teaches."""

import dataclasses

import numpy as np
import pytest
from kits.known_parts import gamma_model, gamma_model_with_signal

from stack_counter.errors import ScanError
from stack_counter.parts.gamma_model import Reading, fill_features, fill_size
from stack_counter.parts.scan_spread import ScanSpread
from stack_counter.types import Container, HeightMap, StackVolume, ViewTally

SCAN = Reading(3.0, 6.0, np.log(0.5))


def test_two_independent_sources_are_joined_by_their_variances():
    made = gamma_model_with_signal(0.1)
    posterior = made.posterior(SCAN)
    weight = 0.1**2 / (0.1**2 + 0.04**2)  # of what is said; the prior's own error is 0.1
    expected = np.log(0.6) + weight * (np.log(0.5) - np.log(0.6))
    assert posterior.mean == pytest.approx(expected)
    assert posterior.shares == pytest.approx({"estimator": weight, "piles": 1 - weight})
    assert posterior.std**2 == pytest.approx(0.1**2 * (1 - weight) + 0.03**2)
    assert posterior.estimator_z_score == pytest.approx(
        (np.log(0.5) - np.log(0.6)) / np.hypot(0.1, 0.04))


def test_an_estimator_that_knows_nothing_of_the_part_weighs_nothing():
    posterior = gamma_model().posterior(SCAN)
    assert posterior.mean == pytest.approx(np.log(0.6)) and posterior.shares["estimator"] == 0


def test_counted_scans_shrink_the_part_of_the_error_that_all_share():
    made, seen = gamma_model(), dataclasses.replace(SCAN, log_gamma_counted=np.log(0.7))
    stds, means = [made.posterior(SCAN).std], []
    for count in (1, 3, 30):
        posterior = made.posterior(SCAN, [seen] * count)
        stds.append(posterior.std)
        means.append(posterior.mean)
        shared = 1 / (1 / 0.1**2 + count / 0.03**2)
        assert posterior.std == pytest.approx(np.sqrt(shared + 0.03**2))
        assert sum(posterior.shares.values()) == pytest.approx(1)
    assert stds == sorted(stds, reverse=True) and stds[-1] > 0.03
    assert means == sorted(means) and means[0] < np.log(0.7)
    # A posterior, not an average of ratios: one scan is not believed whole.
    assert means[0] == pytest.approx(np.log(0.6) + 0.1**2 / (0.1**2 + 0.03**2)
                                     * np.log(0.7 / 0.6))


def test_the_error_of_v_is_one_that_counted_scans_take_away():
    made, seen = gamma_model(shared=0.0), dataclasses.replace(SCAN, log_gamma_counted=np.log(0.7))
    assert made.posterior(SCAN, unit_std=0.1).std == pytest.approx(np.hypot(0.1, 0.03))
    assert made.posterior(SCAN, [seen] * 20, 0.1).std < 0.032


def test_an_estimate_without_a_common_name_is_left_out():
    silent = dataclasses.replace(SCAN, log_gamma_estimated=np.nan)
    posterior = gamma_model_with_signal(0.1).posterior(silent)
    assert posterior.mean == pytest.approx(np.log(0.6)) and posterior.estimator_z_score == 0
    assert posterior.shares == {"estimator": 0.0, "piles": 1.0}


def test_drift_is_told_from_scatter():
    made = gamma_model()
    history = [dataclasses.replace(SCAN, log_gamma_counted=np.log(0.6))] * 5
    near, far = (dataclasses.replace(SCAN, log_gamma_counted=np.log(x)) for x in (0.62, 0.75))
    assert abs(made.counted_z_score(near, history)) < 2
    assert made.counted_z_score(far, history) > 3


def test_gamma_over_fills_and_what_it_depends_on():
    made = gamma_model()
    tilted = dataclasses.replace(made, coefficients=np.array([[-0.5, 0.2, -1.0]] * 2))
    gamma, std = tilted.gamma_at(2.0, 5.0)
    assert gamma == pytest.approx(np.exp(-0.5 + 0.2 / 2.5 - 0.2)) and std > 0
    assert tilted.per_tenth_of_width(2.0, 5.0) == pytest.approx(np.exp(1 / 5 - 1 / 5.5) - 1)
    assert made.per_tenth_of_friction == pytest.approx(np.exp(-0.03) - 1)
    assert made.covers(SCAN) and not made.covers(Reading(0.3, 6.0))
    assert fill_features(np.array([0.5]), np.array([4.0])).tolist() == [[1.0, 1.0, 0.25]]


def test_the_size_of_a_stack_is_in_part_lengths():
    top = np.full((20, 30), 0.02, np.float32)
    top[0] = np.nan
    maps = [HeightMap(np.eye(4), 0.01, a) for a in (top, np.zeros_like(top))]
    area = 19 * 30 * 1e-4
    volume = StackVolume(0, 0.02 * area, 0.0, Container("box", np.eye(4)), (0, 0, 0), 1.0, *maps,
                         None, ViewTally())
    height, width = fill_size(volume, 1e-6)
    assert height == pytest.approx(2.0) and width == pytest.approx(np.sqrt(area) / 0.01)
    side = np.cbrt(volume.stack_volume / 1e-6)
    assert fill_size(dataclasses.replace(volume, top=None), 1e-6) == pytest.approx((side, side))
    blind = dataclasses.replace(maps[0], heights=np.full((20, 30), np.nan))
    with pytest.raises(ScanError, match="finite"):
        fill_size(dataclasses.replace(volume, top=blind), 1e-6)


def test_a_scan_of_another_kind_is_read_with_its_shift_and_a_wider_spread():
    made, loose = gamma_model(), dataclasses.replace(SCAN, spread=ScanSpread(0.1, 0.2, 0.3))
    posterior = made.posterior(loose)
    plain = made.posterior(SCAN)
    assert posterior.std == pytest.approx(np.hypot(plain.std, 0.2 * np.sqrt(1 - w_of(made))))
    assert posterior.mean > plain.mean


def w_of(made):
    """Share of the change of kind that the estimate tells: it sees it among its own noise."""
    said = made.noise[1, 1] + 0.2**2 + 0.3**2
    return 0.2**2 / said


def test_counted_scans_of_a_kind_teach_what_that_kind_changes():
    spread = ScanSpread(0.0, 0.2)
    made = gamma_model(shared=0.0)
    scan, seen = (dataclasses.replace(SCAN, spread=spread, log_gamma_estimated=np.nan,
                                      log_gamma_counted=t) for t in (np.nan, np.log(0.7)))
    posterior = made.posterior(scan, [seen] * 30)
    own = np.sqrt(0.03**2 + 0.2**2 / 2)  # half of the kind's variance is each scan's own
    assert posterior.std == pytest.approx(np.sqrt(own**2 + 1 / (2 / 0.2**2 + 30 / own**2)))
    # Those of the kind of the fit tell nothing of it.
    plain = [dataclasses.replace(seen, spread=ScanSpread())] * 30
    assert made.posterior(scan, plain).std == pytest.approx(np.hypot(0.03, 0.2))
