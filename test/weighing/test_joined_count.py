# SPDX-License-Identifier: Apache-2.0
"""Counts by weight, and joined with those by vision, against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from kits.counted_bin import counted_bin

from stack_counter.config import CounterConfig
from stack_counter.counting import make_count, verdict
from stack_counter.types import OccupancyEstimate, Reason
from stack_counter.weighing.joined_count import (
    SETTINGS,
    PieceWeight,
    WeighedCount,
    Weighing,
    count_by_weight,
    join_weight,
    use_weight,
    weighing_of,
)

PIECE = PieceWeight(0.010, 0.0001)  # 10 g, from piece to piece 1%
SCORES = np.sort(np.random.default_rng(0).normal(size=100_000))[50::100]


def vision(count=100, relative_std=0.1, scores=SCORES, **changes):
    """A count by vision of a relative standard deviation."""
    volume = replace(counted_bin().volume, reasons=(), stack_volume=count * 30e-6,
                     stack_volume_std=0.0, **changes)
    return make_count(volume, 12e-6, OccupancyEstimate(0.4, 0.4 * relative_std, scores, "network"),
                      0.9)


def test_the_three_errors_of_a_weight_grow_as_they_must():
    for n in (1, 100, 10_000):
        scatter = count_by_weight(n * 0.01, 1e-9, PieceWeight(0.01, 1e-4, 10**12)).std
        lot = SETTINGS.lot_std_share * n
        assert scatter == pytest.approx(math.hypot(0.01 * math.sqrt(n), lot), rel=1e-6)
        exact = PieceWeight(0.01, 0.0, 10)
        assert count_by_weight(n * 0.01, 0.005, exact).std == pytest.approx(
            math.hypot(0.5, lot), rel=1e-6)
    of_ten = PieceWeight(0.01, 1e-4, 10).mean_std_kg
    assert of_ten == pytest.approx(math.hypot(1e-4 / math.sqrt(10), 0.002 * 0.01))
    assert count_by_weight(1.234, 0.005, PIECE).expected == pytest.approx(123.4)


def test_weights_have_the_error_that_is_said():
    """Drawn as it happens: pieces weighed first, a container of others, a scale's error."""
    random, z = np.random.default_rng(1), []
    for _ in range(400):
        lot = 0.01 * (1 + SETTINGS.lot_std_share * random.normal())
        mean = random.normal(lot, 1e-4, 10).mean()
        net = random.normal(lot, 1e-4, 150).sum() + 0.005 * random.normal()
        weighed = count_by_weight(net, 0.005, PieceWeight(mean, 1e-4, 10))
        z.append((weighed.expected - 150) / weighed.std)
    assert abs(np.mean(z)) < 0.15 and np.std(z) == pytest.approx(1, abs=0.1)


def test_equal_variances_meet_in_the_middle():
    said = vision(100, 0.1)
    joined = join_weight(said, 1.1, WeighedCount(110.0, 11.0 * 1.0))
    share = [source.share for source in joined.sources]
    assert sum(share) == pytest.approx(1) and share[0] == pytest.approx(0.5, abs=0.03)
    assert joined.count == pytest.approx(math.sqrt(100 * 110), abs=1)
    low, high = joined.count_interval
    assert math.log(high / low) == pytest.approx(
        math.log(said.count_interval[1] / said.count_interval[0]) / math.sqrt(2), rel=0.08)
    assert joined.net_weight_kg == 1.1 and joined.status == "ok"
    assert (np.diff(joined.distribution) >= 0).all()
    assert np.quantile(joined.distribution, [0.05, 0.95]) == pytest.approx([low, high], abs=1.5)


def test_an_exact_scale_decides_and_says_what_each_counts():
    joined = use_weight(vision(100), Weighing(1.070, 0.002), PIECE)
    assert joined.count == 107 and joined.count_interval[0] >= 106
    by_vision, by_weight = joined.sources
    assert (by_vision.source, by_vision.count) == ("vision", 100)
    assert (by_weight.source, by_weight.count) == ("weight", 107)
    assert by_weight.share > 0.99
    assert by_weight.count_interval[0] <= 107 <= by_weight.count_interval[1]
    assert verdict(joined.count_interval, 107, 2) == "pass"
    assert verdict(vision(100).count_interval, 107, 2) == "unsure"


def test_a_coarse_scale_leaves_the_count_to_vision():
    joined = use_weight(vision(100, 0.02), Weighing(1.2, 2.0), PIECE)
    assert joined.count == 100 and joined.sources[1].share < 0.01


def test_the_side_of_visions_interval_towards_the_weight_tells():
    skewed = np.sort(np.where(SCORES > 0, 3 * SCORES, SCORES))
    said = vision(100, 0.05, skewed)
    above = use_weight(said, Weighing(1.35, 0.005), PIECE)
    below = use_weight(said, Weighing(0.74, 0.005), PIECE)  # as far on the logarithmic scale
    assert above.status == "ok" and above.count == 135
    assert Reason.FOREIGN_PARTS_OR_WRONG_BIN in below.reasons


@pytest.mark.parametrize("net_kg", [0.50, 2.0, 0.0, -0.5])
def test_a_wrong_weight_is_said_and_not_believed(net_kg):
    said = vision(100, 0.1)
    joined = use_weight(said, Weighing(net_kg, 0.005), PIECE)
    assert joined.reasons == (Reason.FOREIGN_PARTS_OR_WRONG_BIN,) and joined.status == "degraded"
    assert joined.count == said.count
    by_vision, by_weight = (source.count_interval for source in joined.sources)
    assert by_vision == said.count_interval
    assert joined.count_interval == (min(by_vision[0], by_weight[0]),
                                     max(by_vision[1], by_weight[1]))
    assert verdict(joined.count_interval, 100, 30) != "pass", "whatever one of them alone says"
    assert [source.share for source in joined.sources] == [1.0, 0.0]
    assert joined.sources[1].count == max(round(net_kg / 0.01), 0)


@pytest.mark.parametrize("net_kg, count", [(0.0002, 0), (-0.004, 0), (0.0101, 1), (0.0203, 2)])
def test_of_an_empty_container_few_parts_are_believed_to_the_scale(net_kg, count):
    empty = vision(0)
    joined = use_weight(empty, Weighing(net_kg, 0.0005), PIECE)
    assert joined.count == count and joined.status == "ok"
    assert joined.count_interval[0] <= count <= joined.count_interval[1]


def test_a_perfect_scale_is_believed_without_a_word():
    joined = use_weight(vision(0), Weighing(0.0, 1e-6), PieceWeight(100.0, 0.0))
    assert joined.count == 0 and joined.status == "ok"
    exact = join_weight(vision(100), 1.1, WeighedCount(110.0, 1e-12))
    assert exact.count == 110 and exact.count_interval == (110, 110)


def test_many_parts_in_a_container_that_shows_none_are_foreign():
    joined = use_weight(vision(0), Weighing(0.3, 0.0005), PIECE)
    assert joined.count_interval[1] >= 30
    assert Reason.FOREIGN_PARTS_OR_WRONG_BIN in joined.reasons and joined.count == 0


def test_what_keeps_a_weight_from_being_used_is_said():
    said = vision(100)
    assert use_weight(said, None, PIECE) is said
    assert use_weight(said, Weighing(None, 0.005), PIECE).reasons == (Reason.NO_WEIGHT,)
    for count, piece in ((said, None), (vision(100, region="bin_a"), PIECE)):
        unused = use_weight(count, Weighing(1.0, 0.005), piece)
        assert unused.reasons == (Reason.WEIGHT_UNUSED,) and unused.status == "ok"
        assert unused.count == 100 and len(unused.sources) == 1


def test_a_number_of_the_settings_holds_before_the_topic():
    assert weighing_of(CounterConfig(), 3.0) is None
    assert weighing_of(CounterConfig(weight_topic="/kg", tare_kg=1.0), 3.0) == Weighing(2.0, 0.005)
    assert weighing_of(CounterConfig(weight_topic="/kg"), None) == Weighing(None, 0.005)
    assert weighing_of(CounterConfig(weight_topic="/kg", weight_kg=4.0, weight_std_kg=0.01), 3.0
                       ) == Weighing(4.0, 0.01)
