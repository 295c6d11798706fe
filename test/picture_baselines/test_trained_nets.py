# SPDX-License-Identifier: Apache-2.0
"""Baselines that learn: ViT+H, Ours (Color) and BMNet+, small and on made-up pictures."""

import numpy as np
import pytest
import torch

from stack_counter.errors import WeightsError
from stack_counter.picture_baselines import load_baseline
from stack_counter.picture_baselines.bmnet import (
    BMNet,
    BMNetConfig,
    cut_exemplars,
    similarity_loss,
)
from stack_counter.picture_baselines.encoder import make_encoder
from stack_counter.picture_baselines.net_file import read_net, save_net
from stack_counter.picture_baselines.picture import Picture
from stack_counter.picture_baselines.picture_net import (
    PictureNet,
    PictureNetConfig,
    save_picture_net,
)

SMALL = BMNetConfig(side_px=64, exemplar_px=32, width=16)


@pytest.fixture
def picture():
    color = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    return Picture("a", color, "nut", np.array([[5, 5, 20, 20.0], [30, 5, 45, 22]]))


def test_the_own_encoder_and_resnet_have_stride_16():
    pytest.importorskip("transformers", reason="ResNet-50 needs the extra models")
    for name in ("own", "resnet50"):
        with torch.device("meta"):  # shapes alone
            encoder, width = make_encoder(name)
            assert encoder(torch.zeros(2, 3, 64, 96)).shape == (2, width, 4, 6)
    with pytest.raises(WeightsError, match="unknown encoder 'vgg'"):
        make_encoder("vgg")


@pytest.mark.parametrize("name, gives, lowest", [("vit_h", "count", 1), ("color", "gamma", 0.01)])
def test_a_network_comes_back_from_its_file(tmp_path, picture, name, gives, lowest):
    torch.manual_seed(0)
    net, path = PictureNet(PictureNetConfig("own", gives, 64)).eval(), tmp_path / "n.safetensors"
    save_picture_net(path, name, net, {"learnt_from": "nothing"})
    baseline = load_baseline(name, [path])
    (guess,) = baseline.guess(picture)
    assert guess > lowest and baseline.guess(picture) == [guess]
    with pytest.raises(WeightsError, match=f"is of the baseline '{name}'; expected 'bmnet'"):
        load_baseline("bmnet", [path])
    with pytest.raises(WeightsError, match="no weights file"):
        load_baseline(name, [tmp_path / "none"])


@pytest.mark.parametrize("name, side", [("dinov2", 448), ("vit", 64)])
def test_upon_a_frozen_encoder_the_decoder_alone_is_written(tmp_path, picture, name, side):
    pytest.importorskip("transformers", reason="encoders need the extra models")
    from kits.tiny_models import save_dino, save_vit

    folder = {"dinov2": save_dino, "vit": save_vit}[name](tmp_path / name)
    path = tmp_path / "n.safetensors"
    torch.manual_seed(0)
    net = PictureNet(PictureNetConfig(name), folder)
    assert net.side_px == side and not net.train().encoder.model.training
    before = {k: v.clone() for k, v in net.encoder.state_dict().items()}
    losses = learn(net, 3, torch.randn(2, 3, side, side), torch.log(torch.tensor([20.0, 200.0])))
    assert losses[-1] < losses[0]
    assert all(torch.equal(before[k], v) for k, v in net.encoder.state_dict().items())
    save_picture_net(path, "vit_h", net.eval(), {})
    assert path.stat().st_size < 5 * sum(p.numel() for p in net.decoder.parameters())
    (guess,) = load_baseline("vit_h", [path, folder]).guess(picture)
    assert load_baseline("vit_h", [path, folder]).guess(picture) == [guess]
    with pytest.raises(WeightsError, match="no folder with its weights is named"):
        load_baseline("vit_h", [path])


def learn(net, steps, *batch):
    """Losses of a network that learns one batch again and again."""
    optimizer = torch.optim.Adam([p for p in net.parameters() if p.requires_grad], 1e-3)
    losses = []
    for _ in range(steps):
        loss = net.loss(*batch)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    return losses


def test_a_picture_net_learns_what_it_is_shown():
    torch.manual_seed(0)
    net = PictureNet(PictureNetConfig(side_px=64)).train()
    pictures = torch.randn(4, 3, 64, 64) * torch.tensor([0.2, 0.5, 1, 2])[:, None, None, None]
    losses = learn(net, 15, pictures, torch.log(torch.tensor([20.0, 50, 100, 300])))
    assert losses[-1] < 0.3 * losses[0]


def test_bmnet_learns_where_parts_are():
    torch.manual_seed(0)
    net = BMNet(SMALL).train()
    pictures, density = torch.zeros(2, 3, 64, 64), torch.zeros(2, 8, 8)
    for i, places in enumerate([[(1, 1), (5, 3)], [(2, 6), (4, 4), (6, 1)]]):
        for row, col in places:
            pictures[i, :, 8 * row:8 * row + 8, 8 * col:8 * col + 8] = 2.0
            density[i, row, col] = 1.0
    patches, scales = torch.full((2, 1, 3, 32, 32), 2.0), torch.full((2, 1), 5)
    losses = learn(net, 25, pictures, patches, scales, density)
    assert losses[-1] < 0.7 * losses[0]
    # It has begun to use the similarity and the attention.
    assert float(net.attention.gain.detach()) != 0


def test_a_file_that_is_not_whole_is_refused(tmp_path):
    net, path = PictureNet(PictureNetConfig(side_px=64)), tmp_path / "n.safetensors"
    save_net(path, "vit_h", net, {}, without="decoder.0")
    with pytest.raises(WeightsError, match="lacks .'decoder.0"):
        load_baseline("vit_h", [path])
    net.config = BMNetConfig()
    save_net(path, "vit_h", net, {})
    with pytest.raises(WeightsError, match="does not hold the network it names"):
        load_baseline("vit_h", [path])


def test_exemplars_are_cut_out_and_told_by_size():
    color = np.zeros((64, 64, 3), np.uint8)
    color[10:20, 30:40] = 255
    exemplars = cut_exemplars(color, np.array([[30, 10, 39, 19], [0, 0, 63, 63.0]]), SMALL)
    assert exemplars.patches.shape == (2, 3, 32, 32)
    assert exemplars.patches[0].min() > 0  # all white
    assert exemplars.scales.tolist() == [int(10 / 64 * 40), 19]


def test_similarity_is_the_bilinear_one_weighed_by_the_exemplar():
    torch.manual_seed(0)
    net = BMNet(SMALL).eval()
    features, exemplars = torch.randn(1, 16, 2, 3), torch.randn(1, 2, 16)
    got = net.similarity(features, exemplars).detach()
    x = net.project_picture(features[0, :, 1, 2])
    z = net.project_exemplar(exemplars[0, 1])
    assert float(got[0, 1, 1, 2]) == pytest.approx(
        float((x * net.channel_weights(z) * z).sum().detach() * 4), rel=1e-5)


def test_similarities_are_drawn_up_on_parts_alone():
    density = torch.zeros(1, 4, 4)
    density[0, :2, :2] = 1.0
    right, wrong = torch.zeros(1, 2, 2), torch.zeros(1, 2, 2)
    right[0, 0, 0], wrong[0, 1, 1] = 5.0, 5.0
    assert float(similarity_loss(torch.zeros(1, 2, 2), density)) == pytest.approx(np.log(4))
    assert float(similarity_loss(right, density)) < 0.03 < 5 < float(
        similarity_loss(wrong, density))


def test_bmnet_sums_up_a_density_and_needs_exemplars(tmp_path, picture):
    torch.manual_seed(0)
    net, path = BMNet(SMALL).eval(), tmp_path / "b.safetensors"
    save_net(path, "bmnet", net, {})
    baseline = load_baseline("bmnet", [path])
    (guess,) = baseline.guess(picture)
    assert guess > 0
    bare = Picture("a", picture.color, "nut", np.zeros((0, 4)))
    assert baseline.guess(bare) == []
    back = read_net(path, "bmnet", lambda config: BMNet(BMNetConfig(**config)))
    assert back.config == SMALL
