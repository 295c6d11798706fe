# SPDX-License-Identifier: Apache-2.0
"""Members that go on from an earlier weights file."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.gamma_net import GammaNet
from stack_counter.occupancy.known_form import KNOWN_VALUES
from stack_counter.occupancy.maps import CHANNELS
from stack_counter.occupancy.resolution import RESOLUTION_VALUES
from stack_counter.train.warm_start import begin_as_member
from test.kits.gamma_weights import SMALL_NET


@pytest.fixture
def earlier(tmp_path):
    """Two members that know v alone, and their file, which names their folds."""
    nets = [GammaNet(SMALL_NET).eval() for _ in range(2)]
    with torch.no_grad():
        nets[0].head[-1].bias += 1.0  # they say something else
    path = tmp_path / "earlier.safetensors"
    save_members(path, nets, {"folds": "[1, 4]"}, {"scores": np.zeros(3)})
    return nets, path


def test_a_network_that_reads_more_begins_as_the_member_that_left_out_the_same_fold(earlier):
    nets, path = earlier
    net = GammaNet(replace(SMALL_NET, knows_form=True, knows_resolution=True)).eval()
    begin_as_member(net, path, 4)
    x = torch.rand(2, CHANNELS, 64, 64)
    with torch.no_grad():
        begun = net(x, torch.rand(2, KNOWN_VALUES), torch.rand(2, RESOLUTION_VALUES)).log_gamma
        same, other = (of(x).log_gamma for of in reversed(nets))
    # The file is in half precision.
    assert torch.allclose(begun, same, atol=0.02)
    assert not torch.allclose(begun, other, atol=0.02)


def test_a_fold_that_no_member_left_out_is_refused(earlier):
    with pytest.raises(ConfigError, match=r"folds \[1, 4\]; expected one of fold 0: ask for "
                                          "--folds 1 4"):
        begin_as_member(GammaNet(SMALL_NET), earlier[1], 0)


def test_a_file_that_names_no_folds_holds_the_first_ones(tmp_path):
    path = tmp_path / "old.safetensors"
    save_members(path, [GammaNet(SMALL_NET)], {}, {"scores": np.zeros(3)})
    begin_as_member(GammaNet(SMALL_NET), path, 0)
    with pytest.raises(ConfigError, match="expected one of fold 1"):
        begin_as_member(GammaNet(SMALL_NET), path, 1)


def test_a_network_of_other_widths_is_refused(earlier):
    wider = GammaNet(replace(SMALL_NET, widths=(8, 8, 16, 24)))
    with pytest.raises(ConfigError, match="expected a network of the same encoder and widths"):
        begin_as_member(wider, earlier[1], 1)
