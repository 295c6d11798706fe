# SPDX-License-Identifier: Apache-2.0
"""The network as an estimator: which stacks it knows, and what it says of others."""

from dataclasses import replace

import numpy as np
import pytest
from kits.gamma_weights import KNOWING, SMALL_NET, write_gamma_weights
from kits.surfaces import sine_hills, stack_volume_of_heights

from stack_counter.config import CounterConfig
from stack_counter.counting import make_count
from stack_counter.errors import ScanError, WeightsError
from stack_counter.files import write_weights as write_weights_file
from stack_counter.occupancy import make_estimator
from stack_counter.occupancy.baselines import FORMAT, Baselines, Prior
from stack_counter.occupancy.checkpoint import save_members
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.known_form import known_values
from stack_counter.occupancy.maps import stack_maps, surface_features
from stack_counter.occupancy.network import NetworkEstimator, predict_gamma
from stack_counter.occupancy.resolution import resolution_values
from stack_counter.occupancy.weights_file import save_tuning
from stack_counter.parts.catalogue import Part
from stack_counter.parts.informed_gamma import estimate_occupancy, estimator_of_part
from stack_counter.types import (
    PARTS,
    Container,
    Intrinsics,
    KeyView,
    KnownForm,
    MeshMeasures,
    Reason,
)

V = 0.012**3
# Nothing is known of the part, nor how finely the surface was measured.
NOTHING = known_values(KnownForm(), V), resolution_values(0.0, False)


@pytest.fixture
def weights(tmp_path):
    """An untrained ensemble that knows surfaces like `hills`."""
    return write_weights(tmp_path)


def write_weights(folder, **more):
    middle = surface_features(stack_maps(stack_volume_of_heights(sine_hills(1.0)), V))
    return write_gamma_weights(folder / "w.safetensors", middle=middle, **more)


def network(path):
    return NetworkEstimator(path, Prior(Baselines()))


def test_it_says_gamma_and_who_it_is(weights):
    estimate = network(weights).estimate(stack_volume_of_heights(sine_hills(1.0)), V)
    assert 0 < estimate.gamma < 1 and estimate.gamma_std > 0
    assert estimate.estimator == "network test" and estimate.reasons == ()
    assert len(estimate.scores) == 41


def test_a_stack_seen_from_one_side_has_scores_of_its_own(weights):
    seen = replace(stack_volume_of_heights(sine_hills(1.0)), one_side=True)
    one, other = (
        network(weights).estimate(s, V) for s in (seen, stack_volume_of_heights(sine_hills(1.0)))
    )
    assert len(one.scores) == 21
    assert other.gamma == pytest.approx(one.gamma * np.exp(0.1))


def test_the_same_stack_gives_the_same_answer(weights):
    said = {
        network(weights).estimate(stack_volume_of_heights(sine_hills(1.0)), V).gamma
        for _ in range(3)
    }
    assert len(said) == 1


def test_tiles_count_by_what_stands_in_them(weights):
    """A stack beside an empty floor is the stack alone."""
    net, = [network(weights)]
    alone = np.full((90, 90), 0.05)
    wide = np.full((90, 400), 0.01)
    wide[:, :90] = alone
    maps = [stack_maps(stack_volume_of_heights(h, 0.01), V) for h in (alone, wide)]
    one, other = (np.exp(predict_gamma(net._ensemble, m, *NOTHING).log_gamma) for m in maps)
    assert one == pytest.approx(other, rel=0.3)


def test_a_wrong_part_size_is_noticed_and_widens_the_interval(weights):
    right = network(weights).estimate(stack_volume_of_heights(sine_hills(1.0)), V)
    wrong = network(weights).estimate(stack_volume_of_heights(sine_hills(1.0)), 64 * V)
    assert "unlike_training" in wrong.reasons
    assert wrong.gamma_std / wrong.gamma > right.gamma_std / right.gamma


def test_a_layer_of_few_parts_says_so(weights):
    estimate = network(weights).estimate(
        stack_volume_of_heights(np.full((30, 30), 0.003)), 0.02**3
    )
    assert {"shallow_stack"} <= set(estimate.reasons)


def test_less_than_any_part_takes_up_is_an_empty_container(weights):
    grains = replace(stack_volume_of_heights(0.01 + sine_hills(0.01)), stack_volume=0.4 * V)
    assert network(weights).estimate(grains, V).reasons == ()


@pytest.mark.parametrize("laid, rows", [(True, 2), (False, 2), (True, 1)])
def test_level_layers_widen_the_interval_and_say_so(weights, laid, rows):
    """Cubes in rows with gaps between them; one layer is level however it was poured."""
    length, cells = V ** (1 / 3), 120
    y, x = np.mgrid[:cells, :cells] * 0.002
    heights = np.where((x % (1.15 * length) < length) & (y % (1.15 * length) < length),
                       rows * length, 0.0)
    if not laid:
        heights += np.random.default_rng(0).uniform(-1, 1, (cells, cells)) * length
    estimate = network(weights).estimate(stack_volume_of_heights(np.abs(heights)), V)
    assert ("ordered_layers" in estimate.reasons) == (laid and rows == 2)


def test_without_depth_the_prior_answers(weights):
    estimate = network(weights).estimate(stack_volume_of_heights(None), V)
    assert estimate.estimator.startswith("prior") and "no_depth" in estimate.reasons


def test_a_key_view_alone_is_read_with_a_wider_interval(weights):
    """The same hills from straight above; pixels are as far apart as the cells of the map."""
    whole = stack_volume_of_heights(sine_hills(1.0))
    heights = whole.top.heights
    rows, cols = heights.shape
    camera = Intrinsics(cols, rows, 1.0 / whole.top.pitch, 1.0 / whole.top.pitch,
                        (cols - 1) / 2, (rows - 1) / 2)
    view = KeyView(0, camera, np.eye(4), heights.size, np.full(heights.shape, PARTS, np.uint8),
                   1.0 - heights)
    estimate = network(weights).estimate(
        stack_volume_of_heights(None, kind="hull", key_view=view), V)
    of_map = network(weights).estimate(whole, V)
    assert estimate.estimator == "network test" and Reason.SINGLE_VIEW in estimate.reasons
    assert estimate.gamma_std / estimate.gamma > of_map.gamma_std / of_map.gamma


def test_depth_from_colour_is_refused_beside_a_network_that_reads_heights(weights, tmp_path):
    with pytest.raises(WeightsError, match="beside a network that reads heights in part lengths"):
        NetworkEstimator(weights, Prior(Baselines()), depth_folder=tmp_path)


def test_baselines_of_other_shapes_are_refused(tmp_path):
    tensors = {"line": np.zeros(3), "prior": np.zeros(2), "ratios_corrected": np.zeros(1),
               "ratios_extrapolated": np.zeros(1), "ratios_prior": np.zeros(1)}
    write_weights_file(tmp_path / "b.safetensors", FORMAT, tensors, {})
    with pytest.raises(WeightsError, match=r"line is .* expected numbers of shape \(2,\)"):
        Baselines(tmp_path / "b.safetensors")


def test_an_empty_container_needs_no_gamma(weights):
    assert (
        network(weights)
        .estimate(stack_volume_of_heights(np.full((50, 50), 0.01), 0.01), V)
        .reasons
        == ()
    )


def test_an_empty_support_plane_counts_nothing(weights):
    plane = replace(stack_volume_of_heights(np.full((10, 10), np.nan)), stack_volume=0.0,
                    container=Container("none", np.eye(4)))
    count = make_count(plane, V, network(weights).estimate(plane, V), 0.9)
    assert (count.count, count.count_interval) == (0, (0, 0))


def test_nan_heights_everywhere_are_refused(weights):
    with pytest.raises(ScanError, match="0 of 100 cells"):
        network(weights).estimate(stack_volume_of_heights(np.full((10, 10), np.nan)), V)


def test_weights_without_calibration_are_refused(tmp_path):
    path = tmp_path / "w.safetensors"
    save_members(path, [GammaNet(NetConfig((8, 8, 8, 8), (1, 1, 1, 1), 8))], {}, {})
    with pytest.raises(WeightsError, match="calibration"):
        make_estimator(CounterConfig(estimator="network", weights=str(path)))


def test_tuned_last_layers_say_what_the_ridge_wants(weights, tmp_path):
    net, volume, path = (
        network(weights),
        stack_volume_of_heights(sine_hills(1.0)),
        tmp_path / "t.safetensors",
    )
    read = net.last_layer_input(volume, V)
    assert read.shape == (2, 16)
    save_tuning(path, 0.1 * read / (read**2).sum(axis=1, keepdims=True), 0.05, net.name)
    before, after = (n.estimate(volume, V).gamma for n in (net, net.tuned(path)))
    assert np.log(after / before) == pytest.approx(0.15, abs=1e-3)
    assert net.estimate(volume, V).gamma == before, "the network itself stays"
    name = net.tuned(path).name
    assert name.startswith("network test, tuned ")
    save_tuning(path, np.zeros((2, 16)), 0.05, net.name)
    assert net.tuned(path).name != name, "other changes, another name"


def test_tuned_layers_of_another_network_are_refused(weights, tmp_path):
    path = tmp_path / "t.safetensors"
    save_tuning(path, np.zeros((2, 16)), 0.0, "network 9")
    with pytest.raises(WeightsError, match="tuned from 'network 9'; expected 'network test'"):
        network(weights).tuned(path)
    with pytest.raises(WeightsError, match="expected 'stack_counter tuning 1'"):
        network(weights).tuned(weights)
    with pytest.raises(WeightsError, match="no weights file"):
        network(weights).tuned(tmp_path / "none")
    write_weights_file(path, "stack_counter tuning 1", {"weight": np.zeros((2, 16))}, {"of": "x"})
    with pytest.raises(WeightsError, match="expected weight, bias and the name"):
        network(weights).tuned(path)


def test_a_part_with_tuned_layers_is_counted_by_them(weights, tmp_path):
    net, path = network(weights), tmp_path / "t.safetensors"
    save_tuning(path, np.zeros((2, 16)), 0.2, net.name)
    part = Part(V, "nut", tuned=path)
    assert "tuned" in estimator_of_part(net, part).name and estimator_of_part(net, Part(V)) is net
    assert estimator_of_part(Prior(Baselines()), part).name == "prior (baseline)"
    gamma = estimate_occupancy(stack_volume_of_heights(sine_hills(1.0)), part, net).gamma
    assert gamma == pytest.approx(
        net.estimate(stack_volume_of_heights(sine_hills(1.0)), V).gamma * np.exp(0.2)
    )
    save_tuning(path, np.zeros((2, 16)), 0.3, net.name)
    assert estimate_occupancy(stack_volume_of_heights(sine_hills(1.0)), part, net).gamma > gamma, (
        "a changed file is read"
    )


def test_what_is_known_of_the_form_changes_the_estimate_and_its_name(tmp_path):
    path = write_weights(tmp_path, config=replace(SMALL_NET, knows_form=True), **KNOWING)
    net, volume = network(path), stack_volume_of_heights(sine_hills(1.0))
    size = KnownForm((0.03, 0.02, 0.01))
    mesh = replace(size, mesh=MeshMeasures(0.5, 1e-3, 1, (0.01, 0.008, 0.004)))
    by_level = [net, net.knowing(size), net.knowing(mesh)]
    assert net.knowing(KnownForm()) is net and net.knowing(size) is net.knowing(size)
    assert [n.name.partition(", ")[2] for n in by_level] == ["", "size known", "mesh known"]
    estimates = [n.estimate(volume, V) for n in by_level]
    assert len({e.gamma for e in estimates}) == 3
    assert [e.scores.max() for e in estimates] == [1, 2, 3]
    assert by_level[2].last_layer_input(volume, V).shape == net.last_layer_input(volume, V).shape


def test_pictures_have_scores_of_their_own_where_they_were_measured(tmp_path, weights):
    volume = stack_volume_of_heights(sine_hills(1.0))
    pictures = replace(volume, reasons=(Reason.DEPTH_FROM_PICTURES,))
    without = network(weights).estimate(pictures, V)
    measured = write_weights(tmp_path, scores_pictures=np.linspace(-5, 5, 11),
                             centers=np.array([0.1, 0.0, 0.4]))
    seen, by_pictures = (network(measured).estimate(v, V) for v in (volume, pictures))
    assert by_pictures.scores.max() == 5 and seen.scores.max() == 2
    assert by_pictures.gamma == pytest.approx(seen.gamma * np.exp(0.3))
    assert without.scores.max() == 2 and without.gamma == pytest.approx(seen.gamma)


def test_scores_of_too_few_levels_are_refused(tmp_path):
    path = write_weights(tmp_path, config=replace(SMALL_NET, knows_form=True))
    with pytest.raises(WeightsError, match="1 levels of knowledge; expected 3"):
        network(path)


def test_a_tuned_network_that_knows_the_form_stays_tuned(tmp_path):
    path = write_weights(tmp_path, config=replace(SMALL_NET, knows_form=True), **KNOWING)
    net, volume, size = network(path), stack_volume_of_heights(sine_hills(1.0)), KnownForm(
        (0.03, 0.02, 0.01))
    known = net.knowing(size).estimate(volume, V)
    save_tuning(tmp_path / "tuned.safetensors", np.zeros((2, 16)), 0.3, net.name)
    tuned = net.tuned(tmp_path / "tuned.safetensors").knowing(size)
    assert tuned.estimate(volume, V).gamma > known.gamma


def test_a_network_that_reads_no_form_stays_as_it_is(weights):
    net = network(weights)
    assert net.knowing(KnownForm((0.03, 0.02, 0.01))) is net
