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

from stack_counter.occupancy.gamma_net import SHAPE_OUTPUTS
from stack_counter.pretrained import load_pretrained

_SIDE = 448  # pixels: 32 patches of 14
_WIDTHS = (512, 256, 128, 64)
_LOG_SCALE = -2.0  # of the error of log gamma: the paper's network gives none


class DinoNet(nn.Module):
    """(b, CHANNELS, h, w) of `gamma_input.channels` -> as `GammaNet`; reads the local height."""

    def __init__(self, folder: Path):
        """Loads the encoder from the user's folder and freezes it.

        Raises:
            WeightsError: as `load_local`.
        """
        super().__init__()
        self.encoder = load_pretrained(folder, "dinov2", "Dinov2Model", "a DINOv2 model")
        self.encoder.requires_grad_(False)
        config = self.encoder.config
        self._patches = _SIDE // config.patch_size
        layers: list[nn.Module] = []
        width_in = config.hidden_size
        for width in _WIDTHS:
            layers += [nn.Conv2d(width_in, width, 3, 2, 1), nn.ReLU()]
            width_in = width
        self.decoder = nn.Sequential(*layers, nn.AdaptiveAvgPool2d(1), nn.Flatten(),
                                     nn.Linear(width_in, 1), nn.Sigmoid())

    def train(self, mode: bool = True) -> DinoNet:
        """The decoder alone trains."""
        super().train(mode)
        self.encoder.eval()
        return self

    def gamma(self, x: torch.Tensor) -> torch.Tensor:
        """(b,) occupancy ratio."""
        with torch.no_grad():
            pictures = as_pictures(x, self._patches * self.encoder.config.patch_size)
            tokens = self.encoder(pixel_values=pictures).last_hidden_state  # (b, 1 + n * n, c)
            n = self._patches
            features = tokens[:, -n * n:].transpose(1, 2).unflatten(2, (n, n))  # (b, c, n, n)
        return self.decoder(features)[:, 0]

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Log gamma (b,), a constant log scale (b,), and zeros (b, FORM)."""
        gamma = self.gamma(x).float().clamp_min(1e-3)
        return (torch.log(gamma), torch.full_like(gamma, _LOG_SCALE),
                gamma.new_zeros(len(gamma), SHAPE_OUTPUTS))

    def loss(self, x: torch.Tensor, y: torch.Tensor, **_: object) -> torch.Tensor:
        """Squared error of gamma; `y`: (b, 1 + FORM), log gamma first."""
        return functional.mse_loss(self.gamma(x).float(), torch.exp(y[:, 0]))


def as_pictures(x: torch.Tensor, side: int) -> torch.Tensor:
    """(b, 3, side, side) float32: the local height from 0, lowest, to 1, in three equal channels;
    0 where not valid. The paper's networks read a normalised depth map so.
    """
    valid = x[:, 1:2] > 0  # (b, 1, h, w)
    low = torch.where(valid, x[:, :1], torch.inf).amin((2, 3), keepdim=True)
    high = torch.where(valid, x[:, :1], -torch.inf).amax((2, 3), keepdim=True)
    scaled = torch.where(valid, (x[:, :1] - low) / (high - low).clamp_min(1e-6), 0.0)
    return functional.interpolate(scaled, (side, side), mode="bilinear",
                                  align_corners=False).expand(-1, 3, -1, -1)
