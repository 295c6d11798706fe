# SPDX-License-Identifier: Apache-2.0
"""Counted bins: which are taken, what they tell, and which are warned of."""

from dataclasses import replace

import numpy as np
import pytest
from kits.known_parts import (
    SIZE,
    ConstantEstimator,
    V,
    counted_at,
    part_with_piles,
    stack_volume_of_box,
)

from stack_counter.errors import PartError
from stack_counter.parts.calibration import calibrate, count_from_weight, history_at_volume
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.stack_count import count_stack
from stack_counter.weighing.joined_count import PieceWeight


@pytest.fixture
def nut(tmp_path):
    return part_with_piles(tmp_path)


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


@pytest.mark.parametrize("kind", ["none", "hull"])
def test_a_heap_and_a_bag_are_counted_as_bins_are(nut, kind):
    first = count_bin(nut, 150, stack_volume_of_box(kind)).scan
    assert first.container == kind
    again = stack_volume_of_box(kind, height=0.029)
    assert not count_bin(replace(nut, counted=(first,)), 142, again).drifted


def test_a_bin_that_disagrees_with_the_history_drifts(nut):
    part = replace(nut, counted=(counted_at(0.6),) * 4)
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
        (stack_volume_of_box("none"), "container 'none'"),
        (replace(stack_volume_of_box(), top=None), "hull of its outlines"),
    ],
)
def test_a_bin_of_another_rig_is_refused(nut, volume, what):
    part = replace(nut, counted=(counted_at(0.6),))
    with pytest.raises(PartError, match=what):
        count_bin(part, 140, volume)


def test_a_bin_of_another_rig_can_be_forced(nut):
    part = replace(nut, counted=(counted_at(0.6),))
    first = count_bin(part, 140, stack_volume_of_box(focal=900.0), force=True)
    assert first.drift == 0
    both = replace(part, counted=(first.scan, counted_at(0.6)))
    assert count_bin(both, 140, stack_volume_of_box(height=0.02, focal=900.0)).drift != 0, (
        "known by now"
    )


def test_which_side_is_x_is_chance(nut):
    turned = stack_volume_of_box(size=(SIZE[1], SIZE[0], SIZE[2]))
    assert scans_of_same_rig((counted_at(0.7),), turned) == [counted_at(0.7)]


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
    weighed = replace(part, piece_weight=PieceWeight(0.006, 6e-5))
    assert count_from_weight(weighed, 0.6, 0.0) == count_from_weight(weighed, 0.5, 5.0) == 100
    with pytest.raises(PartError, match="known to 5.0%, .* expected the weight of a piece"):
        count_from_weight(replace(part, unit_volume_std=1e-7), 0.54, 0.0)
    with pytest.raises(PartError, match="nor density_g_cm3"):
        count_from_weight(Part(2e-6, "nut"), 0.5, 0.0)
    with pytest.raises(PartError, match="above 0"):
        count_from_weight(part, float("nan"), 1.0)


def test_counted_bins_stay_with_a_part_of_about_the_same_v():
    old = Part(V, "nut", counted=(counted_at(0.6),))
    assert history_at_volume(None, V, force=False) == ()
    kept, = history_at_volume(old, 1.005 * V, force=False)
    assert kept.log_gamma == pytest.approx(np.log(0.6 * 1.005)), "the count is what was counted"
    with pytest.raises(PartError, match="is there with v 1 cm3; expected about that, not 1.2 cm3"):
        history_at_volume(old, 1.2 * V, force=False)
    assert history_at_volume(old, 1.2 * V, force=True) == ()
    measured = replace(old, unit_volume_std=0.1 * V)
    assert len(history_at_volume(measured, 1.2 * V, force=False)) == 1
