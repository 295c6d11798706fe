# SPDX-License-Identifier: Apache-2.0
"""Encoders of colour pictures: our own small one, ResNet-50, and the user's DINOv2 or ViT."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import nn
from typing_extensions import override

from stack_counter.errors import WeightsError
from stack_counter.occupancy.dino_net import patch_features, picture_side
from stack_counter.occupancy.gamma_net import ResidualBlock
from stack_counter.pretrained import load_pretrained

FROZEN = ("dinov2", "vit")  # encoders of the user's, which do not learn
_WIDTHS, _BLOCKS = (32, 64, 96, 128), (1, 2, 2, 2)  # chosen, as of the gamma-network
# ResNet-50 up to its third stage. Source: He et al., "Deep Residual Learning" (2016).
_RESNET50: dict[str, Any] = {"depths": [3, 4, 6], "hidden_sizes": [256, 512, 1024],
                             "layer_type": "bottleneck"}


def make_encoder(name: str, folder: Path | None = None) -> tuple[nn.Module, int]:
    """Builds an encoder, untrained but for `FROZEN`, and says how many channels its features have.

    Args:
        name: `own`, `resnet50`, or one of `FROZEN`.
        folder: of the latter.

    Raises:
        WeightsError: the folder is missing or cannot be loaded, `transformers` is not installed,
            or no encoder has that name.
    """
    if name == "own":
        return OwnEncoder(), _WIDTHS[-1]
    if name == "resnet50":
        return ResNet50(), _RESNET50["hidden_sizes"][-1]
    if name not in FROZEN:
        raise WeightsError(f"unknown encoder '{name}'; expected own, resnet50, "
                           f"{' or '.join(FROZEN)}")
    if folder is None:
        raise WeightsError(f"the encoder is '{name}' and no folder with its weights is named; "
                           "expected one")
    encoder = FrozenEncoder(name, folder)
    return encoder, encoder.model.config.hidden_size


class OwnEncoder(nn.Sequential):
    """Four residual stages, (b, 3, h, w) pictures to (b, 128, h / 16, w / 16) features."""

    def __init__(self) -> None:
        """Builds it untrained."""
        layers: list[nn.Module] = []
        width_in = 3
        for width, blocks in zip(_WIDTHS, _BLOCKS):
            layers += [nn.Conv2d(width_in, width, 4, 2, 1, bias=False), nn.BatchNorm2d(width),
                       nn.ReLU(), *(ResidualBlock(width) for _ in range(blocks))]
            width_in = width
        super().__init__(*layers)


class ResNet50(nn.Module):
    """ResNet-50 to stride 16, of `transformers`: (b, 1024, h / 16, w / 16) features."""

    def __init__(self) -> None:
        """Builds it untrained.

        Raises:
            WeightsError: `transformers` is not installed.
        """
        super().__init__()
        try:
            from transformers import ResNetConfig, ResNetModel
        except ImportError as error:
            raise WeightsError("ResNet-50 needs the package transformers, which is not installed;"
                               " expected pip install 'stack_counter[models]'") from error
        self.model = ResNetModel(ResNetConfig(**_RESNET50))

    @override
    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        return self.model(pictures).last_hidden_state  # (b, 1024, h / 16, w / 16)


class FrozenEncoder(nn.Module):
    """The user's DINOv2 or ViT, which does not learn: features for each patch of a picture."""

    def __init__(self, name: str, folder: Path):
        """Loads it.

        Args:
            name: one of `FROZEN`.
            folder: with its weights.

        Raises:
            WeightsError: the folder cannot be loaded, or `transformers` is not installed.
        """
        super().__init__()
        if name == "dinov2":
            self.model = load_pretrained(folder, name, "Dinov2Model", "a DINOv2 model")
            self.side_px = picture_side(self.model)
        else:  # it reads pictures of the one size that it was trained with
            self.model = load_pretrained(folder, name, "ViTModel", "a ViT model",
                                         add_pooling_layer=False)
            self.side_px = self.model.config.image_size
        self.model.requires_grad_(False)

    @override
    def train(self, mode: bool = True) -> FrozenEncoder:
        return super().train(False)

    @override
    def forward(self, pictures: torch.Tensor) -> torch.Tensor:
        with torch.no_grad():
            return patch_features(self.model, pictures)  # (b, c, side / patch, side / patch)
