# SPDX-License-Identifier: Apache-2.0
"""The network: shapes, learning, and what its weights file may not be."""

import pickle
from dataclasses import replace

import numpy as np
import pytest
import torch
from kits.surfaces import SCORES, network_inputs
from safetensors.torch import save_file

from stack_counter.errors import WeightsError
from stack_counter.occupancy.checkpoint import load_members, save_members
from stack_counter.occupancy.gamma_net import SHAPE_OUTPUTS, GammaNet, NetConfig
from stack_counter.occupancy.known_form import KNOWN_VALUES
from stack_counter.occupancy.maps import CHANNELS, TILE
from stack_counter.occupancy.resolution import RESOLUTION_VALUES

SMALL = NetConfig((8, 8, 16, 16), (1, 1, 1, 1), 16)


def test_shapes_and_finite_values():
    mean, scale, form, read = GammaNet(SMALL).eval()(network_inputs(3))
    assert mean.shape == scale.shape == (3,) and form.shape == (3, SHAPE_OUTPUTS)
    assert torch.isfinite(torch.cat([mean, scale, form.ravel()])).all()


def test_an_empty_tile_gives_finite_values():
    out = GammaNet(SMALL).eval()(torch.zeros(2, CHANNELS, TILE, TILE))
    assert all(torch.isfinite(part).all() for part in out)


def test_padding_does_not_matter_to_the_pooling():
    """The stack in the middle of nothing, moved by whole strides, gives the same answer."""
    net = GammaNet(SMALL).eval()
    x = torch.zeros(2, CHANNELS, TILE + 64, TILE + 64)
    x[0, :, 32:32 + TILE, 32:32 + TILE] = network_inputs(1)[0]
    x[1, :, 48:48 + TILE, 16:16 + TILE] = network_inputs(1)[0]
    with torch.no_grad():
        mean = net(x)[0]
    assert float(mean[0]) == pytest.approx(float(mean[1]), abs=1e-4)


def test_what_is_known_of_the_form_matters_to_a_network_that_reads_it():
    torch.manual_seed(0)
    net, x = GammaNet(replace(SMALL, knows_form=True)).eval(), network_inputs(2)
    nothing, something = torch.zeros(2, KNOWN_VALUES), torch.ones(2, KNOWN_VALUES)
    with torch.no_grad():
        assert torch.equal(net(x)[0], net(x, nothing)[0])
        assert not torch.allclose(net(x)[0], net(x, something)[0])
        plain = GammaNet(SMALL).eval()
        assert torch.equal(plain(x)[0], plain(x, something)[0])


def test_what_is_known_modulates_the_features():
    """It reads them otherwise; that it also stands beside them is not enough."""
    torch.manual_seed(0)
    net, x = GammaNet(replace(SMALL, knows_form=True)).eval(), network_inputs(2)
    known = torch.ones(2, KNOWN_VALUES)
    with torch.no_grad():
        before = net(x, known)[0]
        torch.nn.init.normal_(net.modulation.weight, std=0.5)
        assert not torch.allclose(net(x, known)[0], before)


def test_the_resolution_matters_to_a_network_that_reads_it():
    torch.manual_seed(0)
    net, x = GammaNet(replace(SMALL, knows_resolution=True)).eval(), network_inputs(2)
    usual, coarse = torch.zeros(2, RESOLUTION_VALUES), torch.ones(2, RESOLUTION_VALUES)
    with torch.no_grad():
        assert torch.equal(net(x)[0], net(x, resolution=usual)[0])
        assert not torch.allclose(net(x)[0], net(x, resolution=coarse)[0])
        plain = GammaNet(SMALL).eval()
        assert torch.equal(plain(x)[0], plain(x, resolution=coarse)[0])


def test_it_learns_four_samples_by_heart():
    torch.manual_seed(0)
    net, x, gamma = GammaNet(SMALL), network_inputs(4), torch.tensor([0.2, 0.4, 0.6, 0.8])
    y = torch.cat([torch.log(gamma)[:, None], torch.zeros(4, SHAPE_OUTPUTS)], 1)
    optimizer = torch.optim.Adam(net.parameters(), 5e-3)
    net.train()
    for _ in range(200):
        loss = net.loss(x, y)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    net.head.eval()  # without dropout
    with torch.no_grad():
        guess = torch.exp(net(x)[0])
    # One guess for all is off by 0.3; processors round differently, and end 0.03 to 0.1 apart.
    assert float((guess - gamma).abs().max()) < 0.15


@pytest.mark.parametrize("knows", [{}, {"knows_form": True}, {"knows_resolution": True}])
def test_members_and_calibration_come_back_as_written(tmp_path, knows):
    nets = [GammaNet(replace(SMALL, **knows)).eval() for _ in range(2)]
    save_members(tmp_path / "w.safetensors", nets, {"version": "x"}, SCORES)
    checkpoint = load_members(tmp_path / "w.safetensors")
    x = network_inputs(2)
    with torch.no_grad():
        for a, b in zip(nets, checkpoint.members):
            assert torch.allclose(a(x)[0], b(x)[0], atol=5e-3)  # kept in half precision
    assert checkpoint.facts["version"] == "x" and checkpoint.facts["members"] == "2"
    np.testing.assert_array_equal(checkpoint.calibration["scores"], SCORES["scores"])


def test_what_is_no_weights_file_is_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    with pytest.raises(WeightsError, match="no weights file"):
        load_members(path)
    path.write_bytes(pickle.dumps({"0.head": 1}))
    with pytest.raises(WeightsError, match="not a whole safetensors file"):
        load_members(path)
    save_members(path, [GammaNet(SMALL)], {}, SCORES)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(WeightsError, match="not a whole safetensors file"):
        load_members(path)
    save_file({"a": torch.zeros(1)}, path, metadata={"format": "other 2"})
    with pytest.raises(WeightsError, match="is 'other 2'; expected 'stack_counter gamma 1'"):
        load_members(path)


def test_weights_that_do_not_fit_their_configuration_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    net = GammaNet(SMALL)
    with torch.no_grad():
        net.head[0].weight[0, 0] = float("nan")
    save_members(path, [net], {}, SCORES)
    with pytest.raises(WeightsError, match="NaN"):
        load_members(path)
    save_file({"0.head.0.weight": torch.zeros(3, 3)}, path, metadata={
        "format": "stack_counter gamma 1", "members": "1",
        "config": '{"widths": [8, 8, 16, 16], "blocks": [1, 1, 1, 1], "hidden": 16}'})
    with pytest.raises(WeightsError, match="does not hold the networks it names"):
        load_members(path)
