# SPDX-License-Identifier: Apache-2.0
"""The paper's metrics: perfect input gives 0, one miss an exact number."""

import numpy as np
import pytest

from stack_counter.eval.common import metrics

TRUE = np.array([10.0, 20.0, 70.0])


@pytest.mark.parametrize("name", ["nae", "sre", "mae", "rmse", "smape"])
def test_perfect_is_zero(name):
    assert getattr(metrics, name)(TRUE, TRUE) == 0


@pytest.mark.parametrize("name, value", [
    ("nae", 10 / 100), ("sre", 100 / 5400), ("mae", 10 / 3), ("rmse", (100 / 3) ** 0.5),
    ("smape", 100 / 3 * 10 / 25), ("r2", 1 - 100 / (5400 - 3 * (100 / 3) ** 2)),
])
def test_one_miss_of_ten(name, value):
    assert getattr(metrics, name)(TRUE, TRUE + [0, 10, 0]) == pytest.approx(value)


def test_the_mean_has_no_r2():
    assert metrics.r2(TRUE, np.full(3, TRUE.mean())) == pytest.approx(0)


def test_wilson_holds_the_share_and_stays_in_range():
    low, high = metrics.wilson_interval(90, 100)
    assert (low, high) == (pytest.approx(0.8256, abs=1e-3), pytest.approx(0.9448, abs=1e-3))
    assert metrics.wilson_interval(10, 10)[1] == pytest.approx(1.0)
