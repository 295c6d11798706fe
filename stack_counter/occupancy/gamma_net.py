# SPDX-License-Identifier: Apache-2.0
"""The gamma-network: a small residual encoder that pools by what stands in each place.

gamma is parts' volume over V, and both are integrals over the footprint: features are averaged
with the height of the stack as weight. The network gives log gamma and the scale of its error
(Laplace); while it learns it also gives the part's size, convexity and surface, in part lengths,
which are what gamma depends on. A network that `knows_form` reads what is known of the part's form
beside v, see `known_form`; one that `knows_resolution` how finely the surface was measured, see
`resolution`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import nn
from torch.nn import functional
from typing_extensions import override

from stack_counter.occupancy.known_form import KNOWN_VALUES
from stack_counter.occupancy.maps import CHANNELS
from stack_counter.occupancy.resolution import RESOLUTION_VALUES

SHAPE_OUTPUTS = 3  # log part size, convexity and surface: learnt beside gamma
_TILE_STATISTICS = 3  # log mean height, log valid share and mean distance to the wall
_ENCODER_STRIDE = 16  # pixels of the tile for a cell of the feature map


@dataclass(frozen=True)
class NetConfig:
    """Architecture of a network, stored with its weights.

    Attributes:
        widths: channels of the encoder's stages, at strides 2, 4, 8 and 16.
        blocks: residual blocks of each stage.
        hidden: width of the head's hidden layer.
        by_height: whether features are averaged by height; else every place counts alike.
        scales: how many scales, each half as fine, the tile is read at.
        knows_form: whether it reads what is known of the part's form.
        knows_resolution: whether it reads how finely the surface was measured.
    """

    widths: tuple[int, ...] = (32, 64, 96, 128)
    blocks: tuple[int, ...] = (1, 2, 2, 2)
    hidden: int = 128
    by_height: bool = True
    scales: int = 1
    knows_form: bool = False
    knows_resolution: bool = False


@dataclass(frozen=True)
class GammaNetSettings:
    """Constants of the network's arithmetic; chosen, and only right for weights learnt with them.

    Attributes:
        log_gamma_offset: added to the first output, so that an untrained network estimates a
            common gamma.
        log_scale_offset: added to the second output, so that an untrained network expects a
            common error.
        log_scale_limit: largest distance of the log scale from its offset.
        bare_weight: weight of a valid cell without height, beside heights in part lengths.
        height_floor: added to the mean height, part lengths, before its logarithm.
        dropout: share of the head's hidden values left out while it learns.
        form_width: width of the layers that read what is known of the part's form.
    """

    log_gamma_offset: float = -0.7
    log_scale_offset: float = -2.0
    log_scale_limit: float = 2.0
    bare_weight: float = 0.02
    height_floor: float = 0.05
    dropout: float = 0.2
    form_width: int = 64


SETTINGS = GammaNetSettings()


class NetOutput(NamedTuple):
    """What a network gives for (b, ...) tiles.

    Attributes:
        log_gamma: (b,) log of the occupancy ratio.
        log_scale: (b,) log of the scale of its Laplace error.
        shape_logs: (b, SHAPE_OUTPUTS) logs of part size, convexity and surface, in part lengths.
        last_layer_input: (b, h) what the last layer reads; h is 0 where there is none to tune.
    """

    log_gamma: torch.Tensor
    log_scale: torch.Tensor
    shape_logs: torch.Tensor
    last_layer_input: torch.Tensor


class ResidualBlock(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, width: int):
        """`width`: number of channels in and out."""
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width))

    @override
    def forward(self, x: torch.Tensor) -> torch.Tensor:
        return functional.relu(x + self.body(x))  # (b, width, h, w)


class GammaNet(nn.Module):
    """Reads (b, CHANNELS, TILE, TILE) inputs of `maps.network_channels`."""

    def __init__(self, config: NetConfig):
        """Builds an untrained network."""
        super().__init__()
        self.config = config
        layers: list[nn.Module] = []
        width_in = CHANNELS
        for width, blocks in zip(config.widths, config.blocks):
            layers += [nn.Conv2d(width_in, width, 4, 2, 1, bias=False), nn.BatchNorm2d(width),
                       nn.ReLU(), *(ResidualBlock(width) for _ in range(blocks))]
            width_in = width
        self.encoder = nn.Sequential(*layers)
        form_width = SETTINGS.form_width if config.knows_form else 0
        if config.knows_form:
            self.form = nn.Sequential(nn.Linear(KNOWN_VALUES, form_width), nn.ReLU(),
                                      nn.Linear(form_width, form_width), nn.ReLU())
            # Begins as if nothing were known.
            self.modulation = nn.Linear(form_width, 4 * width_in * config.scales)
            nn.init.zeros_(self.modulation.weight)
            nn.init.zeros_(self.modulation.bias)
        numbers = _TILE_STATISTICS + form_width + RESOLUTION_VALUES * config.knows_resolution
        self.head = nn.Sequential(
            nn.Linear(2 * width_in * config.scales + numbers, config.hidden), nn.ReLU(),
            nn.Dropout(SETTINGS.dropout), nn.Linear(config.hidden, 2 + SHAPE_OUTPUTS))

    @override
    def forward(self, x: torch.Tensor, known: torch.Tensor | None = None,
                resolution: torch.Tensor | None = None) -> NetOutput:
        """Estimates tiles.

        Args:
            x: (b, CHANNELS, h, w) network inputs.
            known: (b, KNOWN_VALUES) of `known_form.known_values`; None: nothing is known. A
                network that does not know the form ignores it.
            resolution: (b, RESOLUTION_VALUES) of `resolution.resolution_values`; None: the usual
                one of depth cameras. A network that does not know the resolution ignores it.
        """
        # Encode and pool the tile at every scale.
        pooled = torch.cat([self._pool_features(x if i == 0 else functional.avg_pool2d(x, 2**i))
                            for i in range(self.config.scales)], 1)
        # Append statistics of the tile itself.
        height = _heights_from(x)
        valid_share = x[:, 1].mean((1, 2)).clamp_min(1e-4)
        statistics = torch.stack([
            torch.log(height.mean((1, 2, 3)) / valid_share + SETTINGS.height_floor),
            torch.log(valid_share), x[:, 2].mean((1, 2)) / valid_share], 1)  # (b, 3)
        # Regress log gamma, its log scale and the part's shape.
        more = []
        if self.config.knows_form:
            form = self.form(x.new_zeros(len(x), KNOWN_VALUES) if known is None else known)
            scale, shift = self.modulation(form).chunk(2, 1)
            pooled, more = pooled * (1 + scale) + shift, [form]
        if self.config.knows_resolution:
            more += [x.new_zeros(len(x), RESOLUTION_VALUES) if resolution is None else resolution]
        hidden = self.head[:-1](torch.cat([pooled, statistics, *more], 1))  # (b, hidden)
        out = self.head[-1](hidden).float()
        limit = SETTINGS.log_scale_limit
        return NetOutput(out[:, 0] + SETTINGS.log_gamma_offset,
                         out[:, 1].clamp(-limit, limit) + SETTINGS.log_scale_offset, out[:, 2:],
                         hidden)

    def loss(self, x: torch.Tensor, y: torch.Tensor, likelihood: bool = True,
             shape_weight: float = 0.1, known: torch.Tensor | None = None,
             resolution: torch.Tensor | None = None) -> torch.Tensor:
        """Negative log likelihood of log gamma (Laplace), and the shape's squared error.

        Args:
            x: (b, CHANNELS, h, w) network inputs.
            y: (b, 1 + SHAPE_OUTPUTS) log gamma and shape.
            likelihood: False: the squared error of log gamma, which knows no scale.
            shape_weight: weight of the shape's error.
            known, resolution: as `forward` takes them.
        """
        log_gamma, log_scale, shape_logs, _ = self(x, known, resolution)
        error = y[:, 0] - log_gamma
        fit = (torch.abs(error) * torch.exp(-log_scale) + log_scale).mean() if likelihood \
            else (error**2).mean()
        return fit + shape_weight * ((shape_logs - y[:, 1:]) ** 2).mean()

    def _pool_features(self, x: torch.Tensor) -> torch.Tensor:
        """(b, CHANNELS, h, w) -> (b, 2 c): mean and deviation of the features, by height."""
        features = self.encoder(x).float()  # (b, c, h / 16, w / 16)
        weight = functional.avg_pool2d(
            _heights_from(x) * self.config.by_height + SETTINGS.bare_weight * x[:, 1:2],
            _ENCODER_STRIDE)
        weight = functional.adaptive_avg_pool2d(weight, features.shape[2:])
        weight = weight / weight.sum((2, 3), keepdim=True).clamp_min(1e-6)  # (b, 1, h/16, w/16)
        mean = (features * weight).sum((2, 3))
        variance = ((features - mean[:, :, None, None]) ** 2 * weight).sum((2, 3))
        return torch.cat([mean, torch.sqrt(variance + 1e-4)], 1)


def _heights_from(x: torch.Tensor) -> torch.Tensor:
    """(b, 1, h, w) heights over the inner surface, part lengths, from network inputs."""
    return torch.expm1(2 * x[:, 3:4])


def knows_form(net: nn.Module) -> bool:
    """Whether a network reads what is known of the part's form."""
    return isinstance(net, GammaNet) and net.config.knows_form
