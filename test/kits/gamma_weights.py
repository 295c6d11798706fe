# SPDX-License-Identifier: Apache-2.0
"""Weights files of small untrained gamma-networks, for tests of what is done with them."""

import numpy as np
import torch

from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig

SMALL_NET = NetConfig((8, 8, 16, 16), (1, 1, 1, 1), 16)
# For a network that reads the part's form: a row for each level of knowledge.
SCORES_BY_LEVEL = np.array([np.linspace(-k, k, 9) for k in (1, 2, 3)])
KNOWING = {"scores": SCORES_BY_LEVEL, "scores_one_side": 2 * SCORES_BY_LEVEL,
           "centers": np.zeros((3, 2))}


def make_gamma_net(config):
    """An untrained network, but for layers that begin at 0: they have weights."""
    net = GammaNet(config)
    if config.knows_form:
        torch.nn.init.normal_(net.modulation.weight, std=0.1)
    return net


def write_gamma_weights(path, config=SMALL_NET, middle=None, **calibration):
    """Writes an ensemble of two that knows surfaces of the features `middle`."""
    torch.manual_seed(1)
    save_members(path, [make_gamma_net(config) for _ in range(2)], {"version": "test"}, {
        "scores": np.linspace(-2, 2, 41), "scores_one_side": np.linspace(-3, 3, 21),
        "centers": np.array([0.1, 0.0]), "middle": np.zeros(6) if middle is None else middle,
        "whiten": np.eye(6) / 0.2, "reach": np.array([3.0]), **calibration})
    return path
