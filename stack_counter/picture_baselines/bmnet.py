# SPDX-License-Identifier: Apache-2.0
"""BMNet+: matches the picture with boxes around a few parts and sums up a density map.

Exemplars are cut out, encoded, averaged and given an embedding of their size in the picture. The
features of picture and exemplars attend to each other (self-similarity), and are compared by a
bilinear similarity whose channels each exemplar weighs itself (dynamic similarity):

    S_ij = (P f_ij + b_x) . [a(z) o (Q z + b_z)]

The mean similarity beside the features gives the density. While it learns, similarities on parts
are also drawn above those elsewhere.

Source: Shi, Lu, Feng, Liu and Cao, "Represent, Compare, and Learn: A Similarity-Aware Framework
for Class-Agnostic Counting" (CVPR 2022); written from the paper, whose weights are not for
commercial use.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import torch
from torch import nn
from torch.nn import functional
from typing_extensions import override

from stack_counter.picture_baselines.encoder import make_encoder
from stack_counter.picture_baselines.net_file import read_net
from stack_counter.picture_baselines.picture import Picture, fit_square, normalized

_FIRST_BIAS = -4.0  # of the density: untrained, a picture holds some twenty parts; chosen
MAX_EXEMPLARS = 3  # Source: the data set FSC-147, by which it was published


@dataclass(frozen=True)
class BMNetConfig:
    """Architecture, stored with the weights; the defaults are those of a small one, chosen.

    Attributes:
        encoder: `own`, or `resnet50` as in the paper; both to stride 16.
        side_px: side of the square that pictures are scaled to.
        exemplar_px: side that exemplars are scaled to.
        width: channels of the features that are compared.
        scales: number of embeddings of an exemplar's size.
        similarity_weight: weight of the loss of similarities.
    """

    encoder: str = "own"
    side_px: int = 256
    exemplar_px: int = 64
    width: int = 128
    scales: int = 20
    similarity_weight: float = 0.01


class Exemplars(NamedTuple):
    """Parts cut out of a picture.

    Attributes:
        patches: (k, 3, p, p) float32, normalised.
        scales: (k,) int64 number of the embedding of their size.
    """

    patches: np.ndarray
    scales: np.ndarray


def cut_exemplars(picture: np.ndarray, boxes: np.ndarray, config: BMNetConfig) -> Exemplars:
    """Cuts exemplars out of a square picture.

    Args:
        picture: (s, s, 3) uint8 RGB.
        boxes: (k, 4) x0, y0, x1, y1, pixels; one or more, at most `MAX_EXEMPLARS` are used.
        config: of the network.
    """
    side = config.exemplar_px
    patches, scales = [], []
    for x0, y0, x1, y1 in np.clip(np.round(boxes[:MAX_EXEMPLARS]), 0, len(picture) - 1).astype(
            int):
        patch = picture[y0:y1 + 1, x0:x1 + 1]
        patches.append(normalized(cv2.resize(patch, (side, side), interpolation=cv2.INTER_LINEAR)))
        share = (y1 - y0 + x1 - x0 + 2) / 2 / len(picture)
        scales.append(min(int(share * 2 * config.scales), config.scales - 1))
    return Exemplars(np.stack(patches), np.array(scales, np.int64))


class SelfSimilarity(nn.Module):
    """Features of the picture and of the exemplars attend to all of them."""

    def __init__(self, width: int):
        """Begins as the identity."""
        super().__init__()
        self.query, self.key, self.value = (nn.Linear(width, width) for _ in range(3))
        self.gain = nn.Parameter(torch.zeros(1))

    @override
    def forward(self, tokens: torch.Tensor) -> torch.Tensor:
        mixed = functional.scaled_dot_product_attention(
            self.query(tokens), self.key(tokens), self.value(tokens))
        return tokens + self.gain * mixed  # (b, n, width)


class BMNet(nn.Module):
    """Gives the density of parts of (b, 3, s, s) pictures at an eighth of their sides."""

    def __init__(self, config: BMNetConfig):
        """Builds it untrained.

        Raises:
            WeightsError: there is no such encoder.
        """
        super().__init__()
        self.config, width = config, config.width
        self.encoder, features = make_encoder(config.encoder)
        self.reduce = nn.Conv2d(features, width, 1)
        self.scale = nn.Embedding(config.scales, width)
        self.attention = SelfSimilarity(width)
        self.project_picture, self.project_exemplar = (nn.Linear(width, width) for _ in range(2))
        self.channel_weights = nn.Sequential(nn.Linear(width, width // 4), nn.ReLU(),
                                             nn.Linear(width // 4, width), nn.Softmax(-1))
        self.density = nn.Sequential(
            nn.Conv2d(width + 1, width, 3, padding=1), nn.ReLU(),
            nn.Upsample(scale_factor=2, mode="bilinear"),
            nn.Conv2d(width, width // 2, 3, padding=1), nn.ReLU(),
            nn.Conv2d(width // 2, 1, 1), nn.Softplus())
        nn.init.constant_(self.density[-2].bias, _FIRST_BIAS)

    def similarity(self, features: torch.Tensor, exemplars: torch.Tensor) -> torch.Tensor:
        """(b, k, h, w) dynamic similarity of (b, c, h, w) features to (b, k, c) exemplars."""
        x = self.project_picture(features.flatten(2).transpose(1, 2))  # (b, h * w, c)
        z = self.project_exemplar(exemplars)
        weighed = self.channel_weights(z) * z * z.shape[-1] ** 0.5  # a(z) sums up to 1
        return (weighed @ x.transpose(1, 2)).unflatten(2, features.shape[2:])

    @override
    def forward(self, pictures: torch.Tensor, patches: torch.Tensor, scales: torch.Tensor
                ) -> tuple[torch.Tensor, torch.Tensor]:
        """Finds parts.

        Args:
            pictures: (b, 3, s, s) normalised.
            patches: (b, k, 3, p, p) exemplars of each.
            scales: (b, k) numbers of their sizes.

        Returns:
            (b, s / 8, s / 8) density, whose sum is the count; and (b, s / 16, s / 16) similarity.
        """
        features = self.reduce(self.encoder(pictures))  # (b, c, h, w)
        b, k = scales.shape
        pooled = self.reduce(self.encoder(patches.flatten(0, 1))).mean((2, 3))  # (b * k, c)
        exemplars = pooled.unflatten(0, (b, k)) + self.scale(scales)  # (b, k, c)
        tokens = self.attention(torch.cat([features.flatten(2).transpose(1, 2), exemplars], 1))
        features = tokens[:, :-k].transpose(1, 2).unflatten(2, features.shape[2:])
        similarity = self.similarity(features, tokens[:, -k:]).mean(1)  # (b, h, w)
        density = self.density(torch.cat([features, similarity[:, None]], 1))[:, 0]
        return density.float(), similarity.float()

    def loss(self, pictures: torch.Tensor, patches: torch.Tensor, scales: torch.Tensor,
             density: torch.Tensor) -> torch.Tensor:
        """Squared error of the (b, s / 8, s / 8) density, and the loss of similarities."""
        estimated, similarity = self(pictures, patches, scales)
        fit = ((estimated - density) ** 2).sum((1, 2)).mean()
        return fit + self.config.similarity_weight * similarity_loss(similarity, density)


def similarity_loss(similarity: torch.Tensor, density: torch.Tensor) -> torch.Tensor:
    """Draws similarities where parts are above those where none are.

    It is -log of what the positive cells have of the sum of exp(similarity). A cell is positive
    if it holds more density than the mean, negative if none; the others do not matter.

    Args:
        similarity: (b, h, w).
        density: (b, 2 h, 2 w) true density.
    """
    cells = functional.avg_pool2d(density[:, None], 2)[:, 0].flatten(1)
    positive = cells > cells.mean(1, keepdim=True)
    negative = cells <= 1e-6
    logs, least = similarity.flatten(1), torch.finfo(similarity.dtype).min
    all_of_them = torch.logsumexp(logs.masked_fill(~(positive | negative), least), 1)
    return (all_of_them - torch.logsumexp(logs.masked_fill(~positive, least), 1)).mean()


class BMNetBaseline:
    """A trained `BMNet`."""

    def __init__(self, path: Path):
        """Loads the network.

        Raises:
            WeightsError: the file cannot be loaded, or is another baseline's.
        """
        self._net = read_net(path, "bmnet", lambda config: BMNet(BMNetConfig(**config)))

    def guess(self, picture: Picture) -> list[float]:
        """Sums up the density; none where no exemplar is given."""
        if not len(picture.exemplars):
            return []
        config = self._net.config
        square = fit_square(picture.color, config.side_px)
        boxes = square.moved(picture.exemplars.reshape(-1, 2, 2)).reshape(-1, 4)
        exemplars = cut_exemplars(square.color, boxes, config)
        with torch.inference_mode():
            density, _ = self._net(torch.from_numpy(normalized(square.color))[None],
                                   torch.from_numpy(exemplars.patches)[None],
                                   torch.from_numpy(exemplars.scales)[None])
        return [float(density.sum())]
