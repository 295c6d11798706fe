# SPDX-License-Identifier: Apache-2.0
"""One scan of several stacks: a volume, or an error, for each named region."""

from dataclasses import replace

import pytest
from kits.analytic import Scene
from kits.bags import CAMERA

from stack_counter.config import ReconstructorConfig
from stack_counter.config.named_region import NamedRegion
from stack_counter.errors import ConfigError, ViewError
from stack_counter.pipeline import StackCounter
from stack_counter.region_counters import RegionCounters

SIZE = (0.3, 0.3, 0.3)
REGIONS = {"half": (-0.2, 0.0, 0.1), "nowhere": (5.0, 0.0, 0.1), "quarter": (0.2, 0.0, 0.1)}


def settings(names=tuple(REGIONS), **others):
    return ReconstructorConfig(regions=tuple(
        NamedRegion(name, REGIONS[name], SIZE) for name in names), **others)


def views(count=6):
    scene = Scene().bin((0.2, 0.15, 0.1), 0.006, 0.006, 0.05, x=-0.2)
    scene.bin((0.2, 0.15, 0.1), 0.006, 0.006, 0.025, x=0.2)
    camera = replace(CAMERA, width=320, height=240, fx=305.0, fy=305.0, cx=159.5, cy=119.5)
    return scene.views(count, radius=0.8, camera=camera)


@pytest.fixture(scope="module")
def recorded():
    return views()


def measured(counters, recorded):
    for view in recorded:
        counters.add_view(view)
    return {result.region: result for result in counters.volumes()}


def test_each_region_has_its_own_volume_and_one_that_fails_does_not_stop_the_others(recorded):
    counters = RegionCounters(settings())
    results = measured(counters, recorded)
    assert list(results) == list(REGIONS)
    for name, fill in (("half", 0.05), ("quarter", 0.025)):
        volume = results[name].volume
        assert volume.region == name and volume.container.kind == "box" and not results[name].error
        assert volume.stack_volume == pytest.approx(0.2 * 0.15 * fill, rel=0.05)
        assert volume.views.used == results[name].tally.used == 6
    assert results["nowhere"].volume is None and results["nowhere"].error
    assert counters.tally.used == counters.tally.received == 6
    assert len(counters.regions) == 3
    alone = StackCounter(settings().of_region(settings().regions[0]))
    for view in recorded:
        alone.add_view(view)
    assert alone.volume().stack_volume == results["half"].volume.stack_volume


def test_without_names_it_is_one_stack_counter(recorded):
    (name, result), = measured(RegionCounters(ReconstructorConfig()), recorded[:2]).items()
    assert name == "" and result.error == (
        "2 views used of 2 (skipped: {}); expected at least 3")


def test_a_view_that_no_region_takes_is_refused_and_counted(recorded):
    counters = RegionCounters(settings(("half", "quarter")))
    with pytest.raises(ViewError, match="expected one to tell regions apart"):
        counters.add_view(replace(recorded[0], depth=None))
    with pytest.raises(ViewError, match="empty_depth"):
        counters.add_view(replace(recorded[0], depth=0 * recorded[0].depth))
    counters.skip_view(ViewError("overrun", "too late"))
    counters.add_view(recorded[0])
    tally = counters.tally
    assert (tally.received, tally.used) == (4, 1)
    assert tally.skipped == {"no_depth": 1, "empty_depth": 1, "overrun": 1}
    counters.start()
    assert counters.tally.received == 0 and counters.views == []


def test_one_stack_counter_refuses_several_regions():
    with pytest.raises(ConfigError, match=r"regions names \['half', .*expected none"):
        StackCounter(settings())


def test_a_defect_is_raised_unless_a_node_is_to_go_on(monkeypatch):
    def fail(self):
        raise IndexError("of ours\nin two lines")

    monkeypatch.setattr(StackCounter, "volume", fail)
    counters, said = RegionCounters(settings()), []
    with pytest.raises(IndexError):
        next(counters.volumes())
    results = list(counters.volumes(said.append))
    assert [result.region for result in results] == list(REGIONS) and len(said) == len(results)
    assert "IndexError: of ours in two lines; expected" in results[0].error
    assert "\n" not in results[0].error and "Traceback" in said[0]
