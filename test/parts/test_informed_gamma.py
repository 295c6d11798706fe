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
from stack_counter.occupancy.baselines import Baselines, Prior
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.parts.informed_gamma import estimate_occupancy
from stack_counter.stack_count import count_stack
from stack_counter.types import Reason


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
    "volume",
    [
        stack_volume_of_box("none"),
        stack_volume_of_box("hull"),
        replace(stack_volume_of_box(), reasons=(Reason.DEPTH_FROM_PICTURES,)),
        replace(stack_volume_of_box("hull"), top=None, inner=None),
    ],
)
def test_piles_hold_with_a_wider_spread_without_container_or_depth(nut, volume):
    estimate = estimate_occupancy(volume, nut, ConstantEstimator())
    usual = estimate_occupancy(stack_volume_of_box(), nut, ConstantEstimator())
    assert estimate.shares["piles"] > usual.shares["piles"] and 0.5 < estimate.gamma < 0.8
    assert estimate.gamma_std / estimate.gamma > usual.gamma_std / usual.gamma
    assert "container_unlike_piles" in estimate.reasons
    assert not {"container_unlike_piles", "part_unused"} & set(usual.reasons)


def test_a_closed_container_that_was_counted_tells_of_the_next(nut):
    bag = stack_volume_of_box("hull", size=(0.0, 0.0, 0.0))
    counted = replace(counted_at(0.4), container="hull", inner_size_m=(0.0, 0.0, 0.0))
    known = [
        estimate_occupancy(bag, replace(nut, counted=(counted,) * n), ConstantEstimator())
        for n in (0, 1, 3)
    ]
    assert [e.counted_scans for e in known] == [0, 1, 3]
    assert known[0].gamma > known[1].gamma > known[2].gamma > 0.4
    stds = [e.gamma_std / e.gamma for e in known]
    assert stds == sorted(stds, reverse=True)
    assert "container_unlike_piles" not in known[1].reasons


def test_a_bin_counted_by_depth_tells_of_the_same_part_in_a_bag():
    part = Part(V, "nut", counted=(counted_at(0.7),))
    bag = replace(stack_volume_of_box("hull"), reasons=(Reason.DEPTH_FROM_PICTURES,))
    estimate = estimate_occupancy(bag, part, ConstantEstimator())
    assert estimate.counted_scans == 1 and estimate.shares["counted"] > 0
    assert {"calibrated_elsewhere", "container_unlike_piles"} <= set(estimate.reasons)


def test_the_width_of_a_counted_bin_of_another_rig_says_nothing():
    bag = stack_volume_of_box("hull")
    parts = (Part(V, "nut", counted=(replace(counted_at(0.7), width=w),)) for w in (5.0, 15.0))
    narrow, wide = (estimate_occupancy(bag, part, ConstantEstimator()) for part in parts)
    assert narrow.gamma == wide.gamma and narrow.gamma_std == wide.gamma_std


def test_the_mean_of_the_training_piles_is_no_other_estimator(nut):
    hull = replace(stack_volume_of_box("hull"), top=None, inner=None)
    estimate = estimate_occupancy(hull, nut, Prior(Baselines()))
    assert estimate.gamma == pytest.approx(0.6, abs=0.01)
    assert "estimator_unheard" not in estimate.reasons and "no_depth" in estimate.reasons


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
