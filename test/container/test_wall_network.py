# SPDX-License-Identifier: Apache-2.0
"""Psi: crops that show where points lie to the outer face, and a network that learns from them."""

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from stack_counter.container.wall_network import (
    CHANNELS,
    SIDE,
    estimate_thickness,
    load_wall_net,
    outer_width,
    wall_crop,
)
from stack_counter.container.wall_shapes import RoundWall
from stack_counter.errors import ViewError, WeightsError
from stack_counter.sim import read_scenes, record
from stack_counter.train.wall import noisy_outline, train_wall_net
from stack_counter.train.wall_net import WallNet, save_wall_net


@pytest.fixture(scope="module")
def seen():
    """A bin's true outer face, the height of its rim, its wall, and three views."""
    from stack_counter.eval.common.sets import find_set_folder

    scene = next(s for s in read_scenes(find_set_folder("unseen"), 5))
    form = noisy_outline(scene, np.random.default_rng(0), 0.0)
    return form, scene.container.rim_height_m, scene.container, record(scene, 3, color=False)


def test_a_crop_says_where_points_lie(seen):
    form, height, box, views = seen
    crop = wall_crop(views[0], form, height, 0.0)
    assert crop.shape == (CHANNELS, SIDE, SIDE) and crop.dtype == np.float32
    above, inside, valid = crop * outer_width(form)
    # The rim is what is as high as itself: it lies within the wall of the outline.
    rim = (np.abs(above) < 0.0015) & (crop[2] > 0.9) & (inside > -0.02)
    assert rim.sum() > 20
    assert np.median(inside[rim]) < box.wall_thickness_m + 0.002


def test_the_width_of_a_box_and_of_a_round_one(seen):
    x, y = np.array(seen[2].inner_size_m[:2]) + 2 * seen[2].wall_thickness_m
    assert outer_width(seen[0]) == pytest.approx(np.sqrt(x * y), rel=1e-6)
    assert outer_width(RoundWall(np.array([0, 0, 0.1, 0.0, 0.0]))) == pytest.approx(
        0.1 * np.sqrt(np.pi), rel=0.01)


def test_a_container_far_outside_is_out_of_sight(seen):
    away = seen[0].with_params(seen[0].params + [50, 0, 0, 0, 0, 0])
    with pytest.raises(ViewError, match="out_of_sight|expected at least"):
        wall_crop(seen[3][0], away, seen[1], 0.0)
    assert estimate_thickness(seen[3], away, seen[1], 0.0) is None


def test_it_learns_two_thicknesses_apart():
    random = np.random.default_rng(0)
    side = 32  # the network takes any
    target = np.log(np.where(np.arange(48) % 2, 0.05, 0.01)).astype(np.float32)
    crops = random.normal(0, 0.02, (48, CHANNELS, side, side)).astype(np.float32)
    columns = np.arange(side) / side
    for crop, t in zip(crops, target):
        crop[1] += columns < np.exp(t) * 4  # a rim as wide as four walls
    net = train_wall_net(crops.astype(np.float16), target, batch=8)
    with torch.inference_mode():
        guess = net(torch.from_numpy(crops[:8]))[0].numpy()
    assert guess[1::2].min() > guess[::2].max() + 0.5


def test_it_gives_metres_with_a_spread(seen):
    thickness = estimate_thickness(seen[3], seen[0], seen[1], 0.0)
    assert thickness.mean == pytest.approx(seen[2].wall_thickness_m, abs=0.003)
    assert thickness.std > 0


def test_weights_come_back_or_are_refused(tmp_path):
    path, net = tmp_path / "w.safetensors", WallNet().eval()
    save_wall_net(path, net, {})
    crops = np.random.default_rng(0).random((2, CHANNELS, SIDE, SIDE), np.float32)
    with torch.no_grad():
        expected = net(torch.from_numpy(crops))
    for ours, theirs in zip(load_wall_net(path)(crops=crops), expected):
        assert ours == pytest.approx(theirs.numpy(), abs=1e-2)  # weights are kept by halves
    with pytest.raises(WeightsError, match="no weights file"):
        load_wall_net(tmp_path / "none")
    (tmp_path / "bad").write_bytes(b"no safetensors")
    with pytest.raises(WeightsError, match="not a whole safetensors file"):
        load_wall_net(tmp_path / "bad")
    save_file({"a": torch.zeros(1)}, tmp_path / "other", metadata={"format": "x"})
    with pytest.raises(WeightsError, match="is 'x'; expected"):
        load_wall_net(tmp_path / "other")
