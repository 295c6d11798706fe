# SPDX-License-Identifier: Apache-2.0
"""Counts of a part of which more is known than v."""

from dataclasses import replace

import numpy as np
import pytest
from kits.known_parts import (
    ConstantEstimator,
    V,
    counted_at,
    part_with_piles,
    stack_volume_of_box,
)

from stack_counter.display.report import as_dict, as_text
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.parts.informed_gamma import estimate_occupancy
from stack_counter.stack_count import count_stack


@pytest.fixture
def nut(tmp_path):
    return part_with_piles(tmp_path)


def test_v_alone_is_the_estimator_alone():
    estimate = estimate_occupancy(stack_volume_of_box(), Part(V), ConstantEstimator())
    assert estimate.gamma == 0.5 and estimate.gamma_std == pytest.approx(0.05)
    assert estimate.shares == {"estimator": 1.0} and estimate.reasons == ("few_parts",)
    unsure = estimate_occupancy(
        stack_volume_of_box(), Part(V, unit_volume_std=0.1 * V), ConstantEstimator()
    )
    assert unsure.gamma_std == pytest.approx(0.5 * np.hypot(0.1, 0.1))


def test_the_piles_correct_the_estimator_and_the_count_says_so(nut):
    count = count_stack(stack_volume_of_box(), nut, ConstantEstimator(), 0.9)
    assert 0.5 < count.gamma < 0.6 and set(count.gamma_shares) == {"estimator", "piles"}
    low, high = count.count_interval
    wide = count_stack(stack_volume_of_box(), Part(V), ConstantEstimator(), 0.9).count_interval
    assert high - low < wide[1] - wide[0]
    assert as_dict(count, [])["gamma_shares"] == count.gamma_shares
    assert "the part's piles" in as_text(count, None)


def test_another_estimator_is_not_heard(nut):
    estimate = estimate_occupancy(stack_volume_of_box(), nut, ConstantEstimator(0.3, "prior"))
    assert estimate.gamma == pytest.approx(0.6) and "estimator_unheard" in estimate.reasons


def test_a_wrong_part_in_the_bin_is_a_reason(nut):
    right, wrong = (
        count_stack(stack_volume_of_box(), nut, ConstantEstimator(gamma), 0.9)
        for gamma in (0.55, 0.3)
    )
    assert "part_disagrees" not in right.reasons
    assert "part_disagrees" in wrong.reasons and wrong.status == "degraded"
    assert wrong.gamma_std / wrong.gamma > right.gamma_std / right.gamma


def test_fills_that_no_pile_had_are_a_reason(nut):
    assert (
        "fill_unlike_piles"
        in estimate_occupancy(stack_volume_of_box(height=0.001), nut, ConstantEstimator()).reasons
    )


@pytest.mark.parametrize(
    "volume", [stack_volume_of_box("none"), replace(stack_volume_of_box(), top=None)]
)
def test_without_depth_or_container_what_is_known_is_not_used(nut, volume):
    estimate = estimate_occupancy(volume, nut, ConstantEstimator())
    assert estimate.gamma == 0.5 and "part_unused" in estimate.reasons


def test_another_v_than_the_catalogues_is_a_reason():
    estimate = estimate_occupancy(
        stack_volume_of_box(), Part(V, "nut", overridden=True), ConstantEstimator()
    )
    assert estimate.gamma == 0.5 and "part_unused" in estimate.reasons


def test_single_views_have_their_own_model(nut):
    one = estimate_occupancy(stack_volume_of_box(one_side=True), nut, ConstantEstimator())
    assert one.gamma == pytest.approx(0.6) and one.gamma_std > 0.6 * 0.2


def test_counted_scans_correct_with_and_without_piles(nut):
    for part in (nut, Part(V, "nut")):
        estimate = estimate_occupancy(
            stack_volume_of_box(),
            replace(part, counted=(counted_at(0.7),) * 3),
            ConstantEstimator(),
        )
        assert estimate.counted_scans == 3 and "counted" in estimate.shares
        assert (
            estimate.gamma
            > estimate_occupancy(stack_volume_of_box(), part, ConstantEstimator()).gamma + 0.04
        )
        assert sum(estimate.shares.values()) == pytest.approx(1)
        assert "counted bins (3)" in as_text(
            count_stack(
                stack_volume_of_box(),
                replace(part, counted=(counted_at(0.7),) * 3),
                ConstantEstimator(),
                0.9,
            ),
            None,
        )


@pytest.mark.parametrize(
    "volume",
    [
        stack_volume_of_box("round"),
        stack_volume_of_box(size=(0.2, 0.08, 0.05)),
        stack_volume_of_box(focal=900.0),
        stack_volume_of_box(one_side=True),
    ],
)
def test_a_calibration_of_another_rig_is_not_used(volume):
    part = Part(V, "nut", counted=(counted_at(0.7),))
    assert scans_of_same_rig(part.counted, stack_volume_of_box()) and not scans_of_same_rig(
        part.counted, volume
    )
    estimate = estimate_occupancy(volume, part, ConstantEstimator())
    assert estimate.gamma == 0.5 and "calibrated_elsewhere" in estimate.reasons
