"""Counts of a part of which more is known than v."""

from dataclasses import replace

import numpy as np
import pytest
from kits.known_parts import (
    COUNTED,
    SIZE,
    ConstantEstimator,
    V,
    gamma_model,
    gamma_model_with_signal,
    stack_volume_of_box,
)

from stack_counter.display.report import as_dict, as_text
from stack_counter.errors import PartError
from stack_counter.parts.calibration import calibrate, count_from_weight
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.parts.informed_gamma import estimate_occupancy
from stack_counter.parts.part_models import PartModels
from stack_counter.pipeline import count_stack


@pytest.fixture
def nut(tmp_path):
    PartModels("network 7", gamma_model_with_signal(0.1), gamma_model(0.2), "64 piles").write(
        tmp_path / "nut.json"
    )
    return Part(V, "nut", gamma_prior=tmp_path / "nut.json")


def history(gamma, **changes):
    return replace(COUNTED, log_gamma=float(np.log(gamma)), said=float(np.log(0.5)), height=3.0,
                   width=9.0, inner_size_m=SIZE, **changes)


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
    assert "part_disagrees" not in right.reasons and right.status == "ok"
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
            stack_volume_of_box(), replace(part, counted=(history(0.7),) * 3), ConstantEstimator()
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
                replace(part, counted=(history(0.7),) * 3),
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
    part = Part(V, "nut", counted=(history(0.7),))
    assert scans_of_same_rig(part.counted, stack_volume_of_box()) and not scans_of_same_rig(
        part.counted, volume
    )
    estimate = estimate_occupancy(volume, part, ConstantEstimator())
    assert estimate.gamma == 0.5 and "calibrated_elsewhere" in estimate.reasons


# --- counted bins --------------------------------------------------------------------------

def count_bin(part, count, volume=None, force=False):
    return calibrate(
        part, volume or stack_volume_of_box(), count, ConstantEstimator(), "bag", 0.9, force
    )


def test_a_counted_bin_is_what_it_says(nut):
    counted = count_bin(nut, 150)
    assert counted.scan.log_gamma == pytest.approx(np.log(150 * V / 0.00024))
    assert counted.scan.said == pytest.approx(np.log(0.5)) and counted.scan.container == "box"
    assert (
        counted.count_without_it.count
        == count_stack(stack_volume_of_box(), nut, ConstantEstimator(), 0.9).count
    )
    assert counted.drift == 0 and not counted.drifted
    assert counted.scan.checked() == counted.scan


def test_a_bin_that_disagrees_with_the_history_drifts(nut):
    part = replace(nut, counted=(history(0.6),) * 4)
    assert not count_bin(part, 146).drifted
    assert count_bin(part, 110).drifted


@pytest.mark.parametrize("count", [0, -3, 12, 1400])
def test_an_implausible_count_is_refused_with_both_numbers(nut, count):
    estimated = count_stack(stack_volume_of_box(), nut, ConstantEstimator(), 0.9).count
    with pytest.raises(PartError, match=f"{count} parts counted, {estimated} estimated; expected"):
        count_bin(nut, count)
    if count > 0:
        assert count_bin(nut, count, force=True).scan.count == count
    else:
        with pytest.raises(PartError, match="empty bin says nothing"):
            count_bin(nut, count, force=True)


@pytest.mark.parametrize(
    "volume, what",
    [
        (stack_volume_of_box("round"), "container 'round'"),
        (stack_volume_of_box(size=(0.2, 0.08, 0.05)), "200 x 80 x 50 mm"),
        (stack_volume_of_box(focal=900.0), "900 px"),
        (stack_volume_of_box("none"), "'none'"),
        (replace(stack_volume_of_box(), top=None), "depth"),
    ],
)
def test_a_bin_of_another_rig_is_refused(nut, volume, what):
    part = replace(nut, counted=(history(0.6),))
    with pytest.raises(PartError, match=what):
        count_bin(part, 140, volume)


def test_a_bin_of_another_rig_can_be_forced(nut):
    part = replace(nut, counted=(history(0.6),))
    first = count_bin(part, 140, stack_volume_of_box(focal=900.0), force=True)
    assert first.drift == 0
    both = replace(part, counted=(first.scan, history(0.6)))
    assert count_bin(both, 140, stack_volume_of_box(height=0.02, focal=900.0)).drift != 0, (
        "known by now"
    )


def test_which_side_is_x_is_chance(nut):
    turned = stack_volume_of_box(size=(SIZE[1], SIZE[0], SIZE[2]))
    assert scans_of_same_rig((history(0.7),), turned) == [history(0.7)]


def test_more_than_the_stack_holds_is_refused(nut):
    with pytest.raises(PartError, match="300 parts of 1 cm3 counted in a stack of 240 cm3"):
        count_bin(nut, 300)
    assert count_bin(nut, 300, force=True).scan.count == 300
    empty = replace(stack_volume_of_box(height=0.0001), stack_volume=0.0)
    with pytest.raises(PartError, match="in a stack of 0 cm3"):
        count_bin(nut, 1, empty, force=True)


def test_one_recording_counts_once(nut):
    part = replace(nut, counted=(count_bin(nut, 150).scan,))
    with pytest.raises(PartError, match="bag is there already, of .*, 150 parts; expected an"):
        count_bin(part, 151)
    assert count_bin(part, 151, force=True).scan.count == 151


def test_weights_give_counts():
    part = Part(2e-6, "nut", density=2700.0)
    assert count_from_weight(part, 0.54, 0.0) == 100
    assert count_from_weight(part, 0.5, 5.0) == 100
    with pytest.raises(PartError, match="known to 5.0%, .* expected the weight of a piece"):
        count_from_weight(replace(part, unit_volume_std=1e-7), 0.54, 0.0)
    with pytest.raises(PartError, match="no density_g_cm3"):
        count_from_weight(Part(2e-6, "nut"), 0.5, 0.0)
    with pytest.raises(PartError, match="above 0"):
        count_from_weight(part, float("nan"), 1.0)
