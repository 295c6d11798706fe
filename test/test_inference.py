# SPDX-License-Identifier: Apache-2.0
"""Networks by ONNX Runtime give what they give by torch, and torch is not loaded for them."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
import torch
from kits.gamma_weights import make_gamma_net
from kits.surfaces import sine_hills, stack_volume_of_heights

from stack_counter.errors import WeightsError
from stack_counter.files import shipped_weights
from stack_counter.inference import GRAPH, NetworkSession
from stack_counter.occupancy.baselines import Baselines, Prior
from stack_counter.occupancy.checkpoint import TorchEnsemble, load_members, save_members
from stack_counter.occupancy.ensemble import OnnxEnsemble
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.known_form import known_values
from stack_counter.occupancy.maps import CHANNELS, TILE, stack_maps
from stack_counter.occupancy.network import SHIPPED, NetworkEstimator, predict_gamma
from stack_counter.occupancy.resolution import resolution_values
from stack_counter.occupancy.weights_file import read_network_file
from stack_counter.train.onnx_export import INPUTS, StackedNets, check_graph, export_ensemble
from stack_counter.types import KnownForm, MeshMeasures

V = 0.012**3
SMALL = NetConfig((8, 8, 16, 16), (1, 0, 0, 0), 16, scales=2, knows_form=True,
                  knows_resolution=True)
SHAPE = KnownForm((0.03, 0.02, 0.01), MeshMeasures(0.5, 1e-3, 1, (0.01, 0.008, 0.004)))
NUMBERS = known_values(SHAPE, V), resolution_values(0.1, True)


@pytest.fixture(scope="module")
def ensembles():
    """The shipped networks by torch and by ONNX Runtime."""
    path = shipped_weights(SHIPPED)
    return TorchEnsemble(load_members(path).members), by_onnx_runtime(path)


def by_onnx_runtime(path):
    return OnnxEnsemble(NetworkSession(path, read_network_file(path).tensors))


@pytest.fixture(scope="module")
def small(tmp_path_factory):
    """A file of two small untrained networks with their graph."""
    torch.manual_seed(0)
    nets = [make_gamma_net(SMALL).eval() for _ in range(2)]
    path = tmp_path_factory.mktemp("small") / "w.safetensors"
    save_members(path, nets, {}, {}, export_ensemble(nets))
    return path


@pytest.mark.parametrize("tiles", [1, 5])
def test_the_shipped_networks_give_the_same_for_any_number_of_tiles(ensembles, tiles):
    inputs = np.random.default_rng(tiles).random((tiles, CHANNELS, TILE, TILE), np.float32)
    for by_torch, by_onnx in zip(*(run(inputs, *NUMBERS) for run in ensembles)):
        assert by_torch.shape == by_onnx.shape and by_onnx.dtype == np.float32
        assert by_onnx == pytest.approx(by_torch, abs=1e-5)


def test_the_shipped_networks_predict_the_same_gamma(ensembles):
    maps = stack_maps(stack_volume_of_heights(sine_hills(1.0)), V)
    by_torch, by_onnx = (predict_gamma(run, maps, *NUMBERS) for run in ensembles)
    assert by_onnx.log_gamma == pytest.approx(by_torch.log_gamma, abs=1e-5)
    assert by_onnx.relative_std == pytest.approx(by_torch.relative_std, rel=1e-5)


def test_a_file_with_a_graph_keeps_its_weights(small):
    inputs = np.random.default_rng(0).random((2, CHANNELS, TILE, TILE), np.float32)
    expected = TorchEnsemble(load_members(small).members)(inputs, *NUMBERS)
    for ours, theirs in zip(by_onnx_runtime(small)(inputs, *NUMBERS), expected):
        assert ours == pytest.approx(theirs, abs=1e-5)


def test_a_graph_without_its_weights_is_refused(small, tmp_path):
    graph, path = read_network_file(small).tensors[GRAPH], tmp_path / "w.safetensors"
    calibration = read_network_file(shipped_weights(SHIPPED)).calibration
    save_members(path, [GammaNet(SMALL)], {}, calibration, graph)  # one of two
    with pytest.raises(WeightsError, match="does not hold the network it names"):
        NetworkEstimator(path, Prior(Baselines()))
    save_members(path, [GammaNet(SMALL)], {}, calibration, graph[:99])
    with pytest.raises(WeightsError, match="does not hold the network it names"):
        NetworkEstimator(path, Prior(Baselines()))


def test_a_graph_of_another_architecture_is_noticed(small):
    whole = replace(SMALL, by_height=False)
    nets = [GammaNet(whole).eval() for _ in range(2)]
    with pytest.raises(WeightsError, match="differs by .* from torch; expected at most 1e-05"):
        check_graph(read_network_file(small).tensors[GRAPH], StackedNets(nets), INPUTS)


def test_the_default_estimator_loads_no_torch():
    code = ("import sys\nfrom stack_counter.config import CounterConfig\n"
            "from stack_counter.occupancy import make_estimator\n"
            "make_estimator(CounterConfig())\n"
            "print(*{'torch', 'onnx'} & set(sys.modules))")
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == ""
