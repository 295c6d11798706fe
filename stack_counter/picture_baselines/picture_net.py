# SPDX-License-Identifier: Apache-2.0
"""A number straight from one picture: the paper's "ViT+H" (the count) and "Ours (Color)" (gamma).

Source: paper, section 4.2: an encoder that is frozen, the decoder of the gamma-network, and the
count in the place of gamma; "Ours (Color)" reads colour in the place of depth. The log is learnt,
as counts differ by orders of magnitude. With our own encoder, which learns as well, there is a
figure without foreign weights.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import nn
from torch.nn import functional
from typing_extensions import override

from stack_counter.occupancy.dino_net import scalar_decoder
from stack_counter.picture_baselines.encoder import FROZEN, FrozenEncoder, make_encoder
from stack_counter.picture_baselines.net_file import read_net, save_net
from stack_counter.picture_baselines.picture import Picture, fit_square, normalized

# What the outputs are relative to: the geometric means of typical stacks; chosen.
_TYPICAL = {"count": 100.0, "gamma": 0.4}


@dataclass(frozen=True)
class PictureNetConfig:
    """Architecture of a network, stored with its weights.

    Attributes:
        encoder: `own`, `resnet50`, `dinov2` or `vit`.
        gives: `count` or `gamma`.
        side_px: side of the square that pictures are scaled to, for the first two; the others see
            what they were trained with.
    """

    encoder: str = "own"
    gives: str = "count"
    side_px: int = 256


class PictureNet(nn.Module):
    """Reads (b, 3, side, side) normalised pictures and gives (b,) logs."""

    def __init__(self, config: PictureNetConfig, folder: Path | None = None):
        """Builds it; a frozen encoder comes from the user's folder.

        Raises:
            WeightsError: the encoder cannot be loaded.
        """
        super().__init__()
        self.config = config
        self.encoder, width = make_encoder(config.encoder, folder)
        self.decoder = nn.Sequential(*scalar_decoder(width))
        self.side_px = self.encoder.side_px if isinstance(self.encoder, FrozenEncoder) \
            else config.side_px
        self._offset = float(np.log(_TYPICAL[config.gives]))

    @override
    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        return self.decoder(self.encoder(pictures))[:, 0].float() + self._offset  # (b,)

    def loss(self, pictures: torch.Tensor, logs: torch.Tensor) -> torch.Tensor:
        """Squared error of (b,) true logs."""
        return functional.mse_loss(self(pictures), logs)


class PictureNetBaseline:
    """A trained `PictureNet`."""

    def __init__(self, name: str, path: Path, folder: Path | None = None):
        """Loads the network.

        Args:
            name: `vit_h` or `color`.
            path: file of `train.pictures`.
            folder: of the user's encoder, if the network was trained upon it.

        Raises:
            WeightsError: a file or folder cannot be loaded, or is another baseline's.
        """
        self._net = read_net(path, name, lambda config: PictureNet(
            PictureNetConfig(**config), folder))

    def guess(self, picture: Picture) -> list[float]:
        """Gives the number of parts, or gamma."""
        square = normalized(fit_square(picture.color, self._net.side_px).color)
        with torch.inference_mode():
            return [float(torch.exp(self._net(torch.from_numpy(square)[None]))[0])]


def save_picture_net(path: Path, name: str, net: PictureNet, facts: dict[str, str]) -> None:
    """Writes a network, without a frozen encoder."""
    save_net(path, name, net, facts, without="encoder." if net.config.encoder in FROZEN else "")
