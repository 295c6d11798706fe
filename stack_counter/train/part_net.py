# SPDX-License-Identifier: Apache-2.0
"""The network that finds visible parts, as it is trained; `visible_parts.finder` reads its file.

An encoder with a top-down path (Lin et al., "Feature Pyramid Networks", CVPR 2017), whose finest
features, at half of the maps' resolution, become outputs for every pixel by sub-pixel convolution
(Shi et al., "Real-Time Single Image and Video Super-Resolution", CVPR 2016). The heat map of
middles learns by the focal loss of Zhou et al., "Objects as Points" (2019).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn
from torch.nn import functional

from stack_counter.files import write_weights
from stack_counter.inference import GRAPH
from stack_counter.occupancy.gamma_net import ResidualBlock
from stack_counter.occupancy.maps import CHANNELS
from stack_counter.train.onnx_export import check_graph, export_graph
from stack_counter.visible_parts.decoding import COLS, MIDDLE, OUTPUTS, ROWS, SHARE, SHOWN
from stack_counter.visible_parts.finder import FORMAT, STRIDE

# The last of the targets, which no output answers: whether it is known what a pixel shows.
KNOWN = OUTPUTS


@dataclass(frozen=True)
class PartNetConfig:
    """Architecture of the network; chosen.

    Attributes:
        widths: channels of the encoder's stages, at strides 2, 4, 8 and 16.
        blocks: residual blocks of each stage.
    """

    widths: tuple[int, ...] = (24, 40, 64, 96)
    blocks: tuple[int, ...] = (1, 2, 2, 2)


@dataclass(frozen=True)
class PartLossSettings:
    """How the network's errors are weighed; chosen.

    Attributes:
        middle, shown, share, offset: weights of the four errors.
        hard, near: exponents of the focal loss: how much less it counts what is known well, and
            what lies near a middle.
        first_middle: logit of the heat map before training: middles are rare.
    """

    middle: float = 1.0
    shown: float = 1.0
    share: float = 1.0
    offset: float = 2.0
    hard: float = 2.0
    near: float = 4.0
    first_middle: float = -4.0


SETTINGS = PartLossSettings()


class PartNet(nn.Module):
    """(b, CHANNELS, h, w) inputs of `maps.network_channels` -> ((b, OUTPUTS, h, w),).

    The sides are multiples of `STRIDE`.
    """

    def __init__(self, config: PartNetConfig = PartNetConfig()):
        """Makes an untrained network."""
        super().__init__()
        self.config = config
        self.stages, self.laterals, self.smoothing = (nn.ModuleList() for _ in range(3))
        width_in = CHANNELS
        for width, blocks in zip(config.widths, config.blocks):
            self.stages.append(nn.Sequential(
                nn.Conv2d(width_in, width, 4, 2, 1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
                *(ResidualBlock(width) for _ in range(blocks))))
            width_in = width
        for fine, coarse in zip(config.widths, config.widths[1:]):
            self.laterals.append(nn.Conv2d(coarse, fine, 1))
            self.smoothing.append(ResidualBlock(fine))
        self.head = nn.Sequential(nn.Conv2d(config.widths[0], 4 * OUTPUTS, 3, padding=1),
                                  nn.PixelShuffle(2))
        bias = self.head[0].bias
        with torch.no_grad():
            bias.zero_()
            bias.view(OUTPUTS, 4)[MIDDLE] = SETTINGS.first_middle

    def forward(self, maps: torch.Tensor) -> tuple[torch.Tensor]:
        """Returns the outputs by the numbers of `decoding`."""
        features = []
        for stage in self.stages:
            features.append(stage(features[-1] if features else maps))
        x = features.pop()  # (b, c, h / 16, w / 16)
        for lateral, smooth in zip(reversed(self.laterals), reversed(self.smoothing)):
            x = functional.interpolate(lateral(x), scale_factor=2.0, mode="nearest")
            x = smooth(x + features.pop())
        return (self.head(x),)

    def loss(self, maps: torch.Tensor, targets: torch.Tensor) -> torch.Tensor:
        """Returns the weighted sum of the errors.

        Args:
            maps: (b, CHANNELS, h, w).
            targets: (b, OUTPUTS + 1, h, w) as `part_tiles.make_targets` gives them.
        """
        output = self(maps)[0].float()
        known, shown = targets[:, KNOWN], targets[:, SHOWN] * targets[:, KNOWN]

        def mean_over(weights: torch.Tensor, error: torch.Tensor) -> torch.Tensor:
            return (weights * error).sum() / weights.sum().clamp_min(1.0)

        def cross_entropy(kind: int) -> torch.Tensor:
            return functional.binary_cross_entropy_with_logits(
                output[:, kind], targets[:, kind], reduction="none")

        offset = (output[:, [ROWS, COLS]] - targets[:, [ROWS, COLS]]).abs().sum(1)
        return SETTINGS.middle * _focal_loss(output[:, MIDDLE], targets[:, MIDDLE]) \
            + SETTINGS.shown * mean_over(known, cross_entropy(SHOWN)) \
            + SETTINGS.share * mean_over(shown, cross_entropy(SHARE)) \
            + SETTINGS.offset * mean_over(shown, offset)


def _focal_loss(logits: torch.Tensor, heat: torch.Tensor) -> torch.Tensor:
    """Error of a heat map for each middle, where `heat` is 1; both (b, h, w)."""
    probability = torch.sigmoid(logits)
    middles = (heat == 1).float()
    missed = -functional.logsigmoid(logits) * (1 - probability) ** SETTINGS.hard
    false = -functional.logsigmoid(-logits) * probability ** SETTINGS.hard \
        * (1 - heat) ** SETTINGS.near
    return (middles * missed + (1 - middles) * false).sum() / middles.sum().clamp_min(1.0)


def save_part_net(path: Path, net: PartNet, facts: dict[str, str]) -> None:
    """Writes weights as float16, with their graph; `facts` become metadata of the file.

    Raises:
        WeightsError: ONNX Runtime gives other values than torch.
    """
    net = net.eval()
    tensors = {name: value.half().cpu().numpy() for name, value in net.state_dict().items()
               if not name.endswith("num_batches_tracked")}
    graph = export_graph(net, {"maps": (CHANNELS, 5 * STRIDE, 7 * STRIDE)}, STRIDE)
    check_graph(graph, net, {"maps": (CHANNELS, 2 * STRIDE, STRIDE)})  # another size
    write_weights(path, FORMAT, {**tensors, GRAPH: graph}, facts)
