# SPDX-License-Identifier: Apache-2.0
"""Which reading of a scale belongs to a scan."""

import math

import pytest

from stack_counter.weighing.scale_readings import ScaleReadings

S = 10**9


def readings(*said, std_kg=0.005, max_age_s=10.0):
    """Readings of (seconds, kg) each."""
    scale = ScaleReadings(std_kg, max_age_s)
    for seconds, kg in said:
        scale.add(round(seconds * S), kg)
    return scale


def steady(start, end, kg, step=0.1):
    """Readings every tenth of a second."""
    return [(start + step * i, kg) for i in range(round((end - start) / step) + 1)]


def test_a_steady_scale_is_stable_after_a_second():
    scale = readings(*steady(0, 5, 2.0))
    assert scale.stable_weight(round(0.5 * S)) is None
    assert scale.stable_weight(round(1.1 * S)) == 2.0
    assert scale.stable_weight(5 * S) == 2.0


def test_noise_agrees_and_the_middle_of_the_last_second_is_said():
    scale = readings(*((i / 10, 2.0 + 0.004 * (-1) ** i) for i in range(41)))
    assert scale.stable_weight(4 * S) == pytest.approx(2.0, abs=0.005)


def test_the_newest_stable_weight_is_taken():
    loading = [(3 + i / 10, 2.0 + 0.1 * i) for i in range(1, 11)]
    scale = readings(*steady(0, 3, 2.0), *loading, *steady(4.1, 6, 3.0))
    assert scale.stable_weight(6 * S) == 3.0
    assert scale.stable_weight(round(3.8 * S)) == 2.0, "while parts are poured in: the one before"


def test_an_old_weight_belongs_to_no_scan():
    scale = readings(*steady(0, 3, 2.0))
    assert scale.stable_weight(12 * S) == 2.0
    assert scale.stable_weight(14 * S) is None
    assert readings().stable_weight(S) is None


def test_a_scale_that_speaks_on_change_alone_is_stable_while_it_is_silent():
    scale = readings((0, 0.0), (5, 2.0))
    assert scale.stable_weight(round(4.9 * S)) == 0.0
    assert scale.stable_weight(round(5.5 * S)) == 0.0, "the new one may still change"
    assert scale.stable_weight(7 * S) == 2.0


def test_one_reading_a_second_is_enough():
    scale = readings(*((i * 1.02, 2.0) for i in range(4)))
    assert scale.stable_weight(round(3.1 * S)) == 2.0


@pytest.mark.parametrize("bad", [math.nan, math.inf])
def test_what_is_no_number_is_no_weight(bad):
    assert readings(*steady(0, 5, bad)).stable_weight(5 * S) is None
    scale = readings(*steady(0, 3, 2.0), (3.5, bad))
    assert scale.stable_weight(6 * S) == 2.0


def test_what_is_forgotten_is_too_old_anyway():
    scale, kept = (readings(*steady(0, 30, 2.0)) for _ in range(2))
    kept.forget_before(30 * S)
    for seconds in (30, 35, 41):
        assert kept.stable_weight(seconds * S) == scale.stable_weight(seconds * S)
