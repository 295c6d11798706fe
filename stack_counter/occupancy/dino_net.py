# SPDX-License-Identifier: Apache-2.0
"""The paper's own network: a frozen DINOv2 and a convolutional decoder.

Source: paper, section 3.2 and supplement, "Architecture details": 448x448x3 in, 32x32 features,
convolutions 768-512-256-128-64 at 32-16-8-4-2, ReLU, average pool, linear, sigmoid; squared error
of gamma.
"""

from __future__ import annotations

from pathlib import Path

import torch
from torch import nn
from torch.nn import functional
from typing_extensions import override

from stack_counter.occupancy.gamma_net import SHAPE_OUTPUTS, NetOutput
from stack_counter.pretrained import load_pretrained

_SIDE_PX = 448
_WIDTHS = (512, 256, 128, 64)
# Log of the error's scale, the same for every stack: the paper's network estimates none. Chosen.
_LOG_SCALE = -2.0
_SMALLEST_GAMMA = 1e-3


class DinoNet(nn.Module):
    """Reads the local height of `maps.network_channels`; gives the same as `GammaNet`."""

    def __init__(self, folder: Path):
        """Loads the encoder from the user's folder and freezes it.

        Raises:
            WeightsError: the folder is missing, damaged or of another model, or `transformers` is
                not installed.
        """
        super().__init__()
        self.encoder = load_pretrained(folder, "dinov2", "Dinov2Model", "a DINOv2 model")
        self.encoder.requires_grad_(False)
        self.decoder = nn.Sequential(*scalar_decoder(self.encoder.config.hidden_size),
                                     nn.Sigmoid())

    @override
    def train(self, mode: bool = True) -> DinoNet:
        super().train(mode)
        self.encoder.eval()  # the decoder alone is trained
        return self

    def gamma(self, x: torch.Tensor) -> torch.Tensor:
        """Estimates gamma, (b,), of (b, CHANNELS, h, w) network inputs."""
        with torch.no_grad():
            features = patch_features(self.encoder, heights_as_pictures(x, picture_side(
                self.encoder)))
        return self.decoder(features)[:, 0]

    @override
    def forward(self, x: torch.Tensor, known: torch.Tensor | None = None,
                resolution: torch.Tensor | None = None) -> NetOutput:
        gamma = self.gamma(x).float().clamp_min(_SMALLEST_GAMMA)
        return NetOutput(torch.log(gamma), torch.full_like(gamma, _LOG_SCALE),
                         gamma.new_zeros(len(gamma), SHAPE_OUTPUTS),
                         gamma.new_zeros(len(gamma), 0))

    def loss(self, x: torch.Tensor, y: torch.Tensor, **_: object) -> torch.Tensor:
        """Squared error of gamma.

        Args:
            x: (b, CHANNELS, h, w) network inputs.
            y: (b, 1 + SHAPE_OUTPUTS), log gamma first; the rest is not learnt.
            **_: settings of `GammaNet.loss`, without effect here.
        """
        return functional.mse_loss(self.gamma(x).float(), torch.exp(y[:, 0]))


def scalar_decoder(width_in: int) -> list[nn.Module]:
    """Layers of the paper's decoder: (b, width_in, n, n) features become (b, 1)."""
    layers: list[nn.Module] = []
    for width in _WIDTHS:
        layers += [nn.Conv2d(width_in, width, 3, 2, 1), nn.ReLU()]
        width_in = width
    return [*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(), nn.Linear(width_in, 1)]


def picture_side(encoder: nn.Module) -> int:
    """Side of the pictures that the paper shows a DINOv2 encoder, pixels: whole patches."""
    patch: int = encoder.config.patch_size
    return _SIDE_PX // patch * patch


def patch_features(encoder: nn.Module, pictures: torch.Tensor) -> torch.Tensor:
    """(b, c, n, n) features of a DINOv2 encoder, one for each patch of (b, 3, s, s) pictures."""
    n = pictures.shape[-1] // encoder.config.patch_size
    tokens = encoder(pixel_values=pictures).last_hidden_state  # (b, 1 + n * n, c)
    return tokens[:, -n * n:].transpose(1, 2).unflatten(2, (n, n))


def heights_as_pictures(x: torch.Tensor, side: int) -> torch.Tensor:
    """Turns the local height into grey pictures, as the paper's networks read a depth map.

    Args:
        x: (b, CHANNELS, h, w) network inputs.
        side: of the pictures, pixels.

    Returns:
        (b, 3, side, side) float32 from 0, lowest, to 1, in three equal channels; 0 where the map
        is not valid.
    """
    valid = x[:, 1:2] > 0  # (b, 1, h, w)
    low = torch.where(valid, x[:, :1], torch.inf).amin((2, 3), keepdim=True)
    high = torch.where(valid, x[:, :1], -torch.inf).amax((2, 3), keepdim=True)
    scaled = torch.where(valid, (x[:, :1] - low) / (high - low).clamp_min(1e-6), 0.0)
    return functional.interpolate(scaled, (side, side), mode="bilinear",
                                  align_corners=False).expand(-1, 3, -1, -1)
