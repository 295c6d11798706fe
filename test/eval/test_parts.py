# SPDX-License-Identifier: Apache-2.0
"""Counts of rigs by all that may be known of their parts."""

from dataclasses import replace
from pathlib import Path

import pytest
from kits.known_parts import ConstantEstimator, gamma_model, stack_volume_of_box

from stack_counter.eval.common.part_table import ROWS, format_table
from stack_counter.eval.parts import CachedEstimator, count_all_ways, group_by_rig
from stack_counter.parts.part_models import PartModels
from stack_counter.sim import read_scenes

DATA = Path(__file__).parents[2] / "data" / "unseen-rigs"


@pytest.fixture(scope="module")
def rigs():
    return group_by_rig(list(read_scenes(DATA, 27)))


def test_a_rig_is_one_part_in_one_container(rigs):
    assert [len(rig.scenes) for rig in rigs] == [9, 9, 9]
    for rig in rigs:
        assert len({(s.shape.family, s.shape.seed, s.friction, s.container.inner_size_m)
                    for s in rig.scenes}) == 1
    assert len({rig.friction for rig in rigs}) == 3
    other = replace(rigs[0].scenes[4], shape=rigs[1].scenes[0].shape)
    mixed = group_by_rig([*rigs[0].scenes[:4], other, *rigs[0].scenes[5:]])
    assert [len(rig.scenes) for rig in mixed] == [8]


def test_every_scan_is_counted_by_each_of_the_others(rigs):
    rig = replace(rigs[0], scenes=rigs[0].scenes[:4])
    scans = [(s, stack_volume_of_box(height=0.02 + 0.002 * i)) for i, s in enumerate(rig.scenes)]
    models = PartModels("network 7", gamma_model(), gamma_model(), "piles")
    answers = count_all_ways(rig, scans, models, CachedEstimator(ConstantEstimator()), 0.9)
    counts = {row: sum(a.row == row for a in answers) for row in ROWS}
    assert all(counts[row] == 4 for row in ROWS[:4])
    assert all(counts[row] == 12 for row in ROWS[4:])
    text = format_table([rig], answers, 0)
    assert "1 rigs, 1 parts of 1 families, 4 scans, 0 refused" in text
    assert all(row in text for row in ROWS)


def test_an_estimator_is_asked_once_for_each_scan():
    class Counts(ConstantEstimator):
        asked = 0

        def estimate(self, volume, unit_volume):
            self.asked += 1
            return super().estimate(volume, unit_volume)

    counts, volume = Counts(), stack_volume_of_box()
    remembered = CachedEstimator(counts)
    assert remembered.name == counts.name
    assert remembered.estimate(volume, 1e-6) is remembered.estimate(volume, 1e-6)
    remembered.estimate(volume, 2e-6)
    assert counts.asked == 2
