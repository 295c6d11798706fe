# SPDX-License-Identifier: Apache-2.0
"""Drawn weights of scans that are counted already: nothing is simulated."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from kits.counted_bin import counted_bin

from stack_counter.counting import make_count
from stack_counter.eval.weight import SETTINGS, draw_weighings, format_table
from stack_counter.types import OccupancyEstimate


def counted(index, true, seen):
    """A scene of so many parts of 1 cm3, and its count by vision, known to 10%."""
    scores = np.sort(np.random.default_rng(0).normal(size=10_000))[50::100]
    volume = replace(counted_bin().volume, reasons=(), stack_volume=seen * 2e-6,
                     stack_volume_std=0.0)
    return (SimpleNamespace(index=index, truth=SimpleNamespace(count=true, unit_volume=1e-6)),
            make_count(volume, 1e-6, OccupancyEstimate(0.5, 0.05, scores, "network"), 0.9))


@pytest.fixture(scope="module")
def scans():
    truths = (50, 400, 90, 1000, 150, 250)
    return draw_weighings([counted(i, true, round(true * (1 + 0.1 * (-1) ** i)))
                           for i, true in enumerate(truths)], 0.005, 0.01)


def test_a_scale_is_better_than_vision_and_right_bins_are_right(scans):
    assert len(scans) == 6 * SETTINGS.draws
    errors = {source: np.mean([abs(scan.counts[source] / scan.true - 1) for scan in scans])
              for source in ("vision", "weight", "joined")}
    assert errors["vision"] == pytest.approx(0.1, abs=0.01)
    assert errors["joined"] <= errors["weight"] + 1e-4 < 0.02
    assert not any(scan.flagged for scan in scans)
    covered = np.mean([scan.intervals["joined"][0] <= scan.true <= scan.intervals["joined"][1]
                       for scan in scans])
    assert 0.85 <= covered <= 1


def test_wrong_bins_are_flagged(scans):
    assert all(scan.material_flagged for scan in scans)
    for scan in scans:
        assert scan.bin_factor >= 1 and (scan.bin_flagged or scan.bin_factor < 1.6), scan
    assert any(scan.bin_flagged for scan in scans)


def test_the_table_has_a_line_for_each_source_and_kind_of_bin(scans):
    lines = format_table(scans).splitlines()
    assert [line.split()[0] for line in lines[1:4]] == ["vision", "weight", "joined"]
    assert lines[7] == "right bins: 0 of 120 flagged"
    assert lines[8] == "parts of another material: 120 of 120 flagged"
    assert lines[-1].startswith("another bin, 3 to inf times as heavy or light: ")
    numbers = [line.split(": ")[1].split() for line in lines[9:]]
    assert sum(int(words[2]) for words in numbers) == 120
