# SPDX-License-Identifier: Apache-2.0
"""Damaged recordings give a count that is right, or are refused in one line."""

import pytest
from kits.damaged_bags import DAMAGED, healthy

from stack_counter.bag.replay import replay_direct
from stack_counter.config import CounterConfig, load_config
from stack_counter.errors import StackCounterError, exit_code_of
from stack_counter.files import config_path
from stack_counter.occupancy import make_estimator
from stack_counter.parts.catalogue import Part

CONFIG = load_config(config_path("stack_counter.yaml"))
ESTIMATOR = make_estimator(CounterConfig(estimator="prior"))


def counted(path):
    return replay_direct(path, CONFIG, Part(5e-6), estimator=ESTIMATOR)[0].count


@pytest.fixture(scope="module")
def truth(tmp_path_factory):
    """The count of the healthy recording."""
    return counted(healthy(tmp_path_factory.mktemp("healthy")))


@pytest.mark.parametrize("name", DAMAGED)
def test_a_damaged_recording_is_counted_right_or_refused_in_one_line(name, truth, tmp_path,
                                                                     capsys):
    try:
        count = counted(DAMAGED[name](tmp_path))
    except StackCounterError as error:
        assert exit_code_of(error) == 3 and "\n" not in str(error)
        assert not capsys.readouterr().err  # the line of this error is the only one
        return
    low, high = truth.count_interval
    assert low <= count.count <= high
    assert count.count == truth.count or count.reasons or count.volume.views.used == 6
