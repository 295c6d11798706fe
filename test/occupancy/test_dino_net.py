# SPDX-License-Identifier: Apache-2.0
"""The paper's network and Depth Anything, on tiny random configurations saved to disk."""

import numpy as np
import pytest
import torch
from kits.surfaces import SCORES, network_inputs

from stack_counter.errors import WeightsError
from stack_counter.occupancy.checkpoint import load_members, make_net, save_members

transformers = pytest.importorskip("transformers", reason="DINOv2 needs the extra models")


@pytest.fixture(scope="module")
def dino(tmp_path_factory):
    from kits.tiny_models import save_dino

    return save_dino(tmp_path_factory.mktemp("dino"))


@pytest.fixture(scope="module")
def depth_anything(tmp_path_factory):
    out = tmp_path_factory.mktemp("depth")
    torch.manual_seed(0)
    backbone = transformers.Dinov2Config(
        hidden_size=16, num_hidden_layers=4, num_attention_heads=2, patch_size=14, image_size=518,
        out_indices=[1, 2, 3, 4], apply_layernorm=True, reshape_hidden_states=False)
    config = transformers.DepthAnythingConfig(
        backbone_config=backbone, reassemble_hidden_size=16, neck_hidden_sizes=[8, 8, 8, 8],
        fusion_hidden_size=8, head_hidden_size=4)
    transformers.DepthAnythingForDepthEstimation(config).save_pretrained(out)
    return out


def test_the_decoder_is_the_papers(dino):
    net = make_net("dinov2", dino)
    convolutions = [m for m in net.decoder if isinstance(m, torch.nn.Conv2d)]
    assert [m.out_channels for m in convolutions] == [512, 256, 128, 64]
    seen = []
    hooks = [m.register_forward_hook(lambda _m, _i, out: seen.append(out.shape[-1]))
             for m in convolutions]
    gamma = net.eval().gamma(network_inputs(2))
    [hook.remove() for hook in hooks]
    assert seen == [16, 8, 4, 2]  # from 32
    assert gamma.shape == (2,) and bool(((gamma > 0) & (gamma < 1)).all())


def test_the_encoder_is_frozen_and_the_loss_falls(dino):
    torch.manual_seed(0)
    net, x = make_net("dinov2", dino).train(), network_inputs(4)
    assert not net.encoder.training
    y = torch.log(torch.tensor([[0.2], [0.4], [0.6], [0.8]])).repeat(1, 4)
    before = {k: v.clone() for k, v in net.encoder.state_dict().items()}
    optimizer = torch.optim.Adam([p for p in net.parameters() if p.requires_grad], 1e-3)
    losses = []
    for _ in range(15):
        loss = net.loss(x, y)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < losses[0]
    assert all(torch.equal(before[k], v) for k, v in net.encoder.state_dict().items())


def test_the_decoder_alone_is_written_and_comes_back(dino, tmp_path):
    net, path = make_net("dinov2", dino).eval(), tmp_path / "w.safetensors"
    save_members(path, [net], {}, SCORES)
    assert path.stat().st_size < 2 * sum(p.numel() for p in net.decoder.parameters()) + 20_000
    back = load_members(path, dino).members[0]
    with torch.no_grad():
        assert torch.allclose(net(network_inputs(2))[0], back(network_inputs(2))[0], atol=1e-2)
    with pytest.raises(WeightsError, match="no folder with its weights is named"):
        load_members(path)


def test_another_model_is_refused(depth_anything):
    with pytest.raises(WeightsError, match="'depth_anything'; expected 'dinov2'"):
        make_net("dinov2", depth_anything)


def test_a_picture_gets_nearness(depth_anything):
    from stack_counter.pretrained.depth_anything import MonocularDepth

    picture = np.random.default_rng(0).integers(0, 255, (40, 60, 3), np.uint8)
    near = MonocularDepth(depth_anything).estimate_nearness(picture)
    assert near.shape == (40, 60) and near.dtype == np.float32
    assert (near.min(), near.max()) == (0, pytest.approx(1))
