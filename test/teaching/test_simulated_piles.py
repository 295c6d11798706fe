# SPDX-License-Identifier: Apache-2.0
"""Simulated piles of one part, on the rig that the settings describe."""

import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from kits.known_parts import ConstantEstimator, stack_volume_of_box

from stack_counter.config import Config, CounterConfig, ReconstructorConfig
from stack_counter.container.catalogue import TaughtContainer, save_container
from stack_counter.container.wall_shapes import BoxWall, FreeWall, RoundWall
from stack_counter.errors import PartError, ScanError
from stack_counter.teaching import simulated_piles
from stack_counter.teaching.add_part import make_pile_request
from stack_counter.teaching.simulated_piles import (
    SETTINGS,
    Pile,
    _refuse_restless,
    counted_reading,
    make_pile,
    make_rig_container,
    scale_container,
    simulate_piles,
)

BLOCK = trimesh.creation.box((0.03, 0.02, 0.02))


def test_a_configured_container_is_the_one_simulated():
    config = ReconstructorConfig(container_kind="round", container_inner_size_m=(0.2, 0.2, 0.1),
                                 container_wall_m=0.004)
    made = make_rig_container(config)
    assert (made.kind, made.inner_size_m) == ("cylinder", (0.2, 0.2, 0.1))
    assert made.wall_thickness_m == made.floor_thickness_m == 0.004
    assert make_rig_container(ReconstructorConfig()) is None
    assert make_rig_container(replace(config, container_inner_size_m=(0.0, 0.0, 0.0))) is None
    assert scale_container(made, 1.1).inner_size_m == pytest.approx((0.22, 0.22, 0.11))


@pytest.mark.parametrize("form, kind, size", [
    (BoxWall(np.array([0, 0, 0, 0.308, 0.208, 0.1])), "bin", (0.3, 0.2, 0.1)),
    (RoundWall(np.array([0, 0, 0.104, 0.0, 0.0])), "cylinder", (0.2, 0.2, 0.1)),
    (FreeWall(np.concatenate([[0.104], np.zeros(26)]), np.zeros(2)), "bag", (0.2, 0.2, 0.1))])
def test_a_taught_container_is_the_one_simulated(tmp_path, form, kind, size):
    path = tmp_path / "containers.yaml"
    save_container("mine", TaughtContainer(form, 0.004, 0.005, 0.105), path)
    made = make_rig_container(ReconstructorConfig(container="mine", container_catalogue=str(path)))
    assert made.kind == kind and made.inner_size_m == pytest.approx(size, abs=2e-3)
    assert made.draft_rad == pytest.approx(np.arctan(0.1) if kind == "bin" else 0.0, abs=1e-3)


def test_a_scan_that_shows_nothing_of_a_pile_is_none():
    with pytest.raises(ScanError, match="V of 50 parts is 0.0 m3; expected some"):
        counted_reading(
            replace(stack_volume_of_box(), stack_volume=0.0), 1e-6, ConstantEstimator(), 50
        )
    assert np.exp(
        counted_reading(stack_volume_of_box(), 1e-6, ConstantEstimator(), 120).log_gamma_counted
    ) == pytest.approx(0.5)


def test_a_pile_is_seen_from_around_and_from_above():
    pytest.importorskip("sapien", reason="the physics engine has no wheel for this Python")
    size = (0.12, 0.1, 0.06)
    config = Config(reconstructor=ReconstructorConfig(container_kind="box",
                                                      container_inner_size_m=size),
                    counter=CounterConfig(estimator="prior"))
    order = make_pile_request(BLOCK.vertices, BLOCK.faces, config, (0.3, 0.4))
    pile, same = make_pile(order, 3), make_pile(order, 3)
    assert pile == same, "depends on order and index alone"
    length = (0.03 * 0.02 * 0.02) ** (1 / 3)
    for seen in (pile.arc, pile.above):
        assert 0.3 <= seen.friction <= 0.4 and 0 < seen.volume_std < 0.3
        assert 0.35 < np.exp(seen.reading.log_gamma_counted) < 0.85
        assert 0.7 < seen.reading.width * length / np.sqrt(size[0] * size[1]) < 1.3


def test_a_part_is_refused_only_where_most_piles_come_to_no_rest():
    rests = Pile(None, None)
    fails = Pile(None, None, ("unsettled: 0.2 part sizes/s",) * (SETTINGS.max_tries - 1)
                 + ("penetration: 0.03 of the part size; expected at most 0.02",))
    mixed = [rests, fails] * 5
    assert list(_refuse_restless(mixed)) == mixed
    with pytest.raises(PartError, match=r"4 of 5 piles failed 12 times each \(11 x unsettled, "
                       r"1 x penetration\), the last by penetration: 0.03 of .*; check --unit"):
        list(_refuse_restless([rests, fails, fails, fails, fails]))


def test_piles_come_in_their_order_whichever_gets_done_first(monkeypatch):
    """What a part is refused for, and its model to the last bit, are no matter of load."""
    order = make_pile_request(BLOCK.vertices, BLOCK.faces, Config())
    with ThreadPoolExecutor(3) as pool:
        monkeypatch.setattr(simulated_piles, "worker_pool", lambda workers: nullcontext(pool))
        monkeypatch.setattr(simulated_piles, "make_pile", make_late_pile)
        piles = list(simulate_piles(order, 3, workers=3))
    assert [pile.failed_tries for pile in piles] == [("0",), ("1",), ("2",)]


def make_late_pile(request, index):
    """The later, the earlier."""
    time.sleep(0.2 * (2 - index))
    return Pile(None, None, (str(index),))
