# SPDX-License-Identifier: Apache-2.0
"""Psi as it is trained, and the file in which `container.wall_network` finds it.

Source: paper, section 3.3: dilated convolutions, a ratio of the container's size.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import torch
from torch import nn

from stack_counter.container.wall_network import CHANNELS, FORMAT, SIDE
from stack_counter.files import write_weights
from stack_counter.inference import GRAPH
from stack_counter.train.onnx_export import export_graph


@dataclass(frozen=True)
class WallNetSettings:
    """Sizes of the network; chosen, and fixed by the format of its weights.

    Attributes:
        width: channels of each layer.
        dilations: one layer of 3 x 3 convolutions for each.
        hidden: units of the layer before the output.
        dropout: share of these that training leaves out.
        first_log_ratio: added to the first output, so that training starts near the walls of
            common containers.
        log_scale_limit: the second output is clipped to plus and minus this, then lowered by 1.
    """

    width: int = 32
    dilations: tuple[int, ...] = (1, 2, 4, 8)
    hidden: int = 64
    dropout: float = 0.1
    first_log_ratio: float = -3.5
    log_scale_limit: float = 3.0


SETTINGS = WallNetSettings()


class WallNet(nn.Module):
    """(b, CHANNELS, SIDE, SIDE) -> log of thickness over width, log of the scale of its error."""

    def __init__(self) -> None:
        """Makes a network with random weights."""
        super().__init__()
        s = SETTINGS
        layers: list[nn.Module] = [nn.Conv2d(CHANNELS, s.width, 4, 2, 1, bias=False),
                                   nn.BatchNorm2d(s.width), nn.ReLU()]
        for dilation in s.dilations:
            layers += [nn.Conv2d(s.width, s.width, 3, 1, dilation, dilation, bias=False),
                       nn.BatchNorm2d(s.width), nn.ReLU()]
        self.encoder = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.Linear(2 * s.width, s.hidden), nn.ReLU(),
                                  nn.Dropout(s.dropout), nn.Linear(s.hidden, 2))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(b, CHANNELS, h, w) float32 -> (b,) log of thickness over width, (b,) log of scale."""
        s = SETTINGS
        features = self.encoder(x).float()  # (b, c, h / 2, w / 2)
        pooled = torch.cat([features.mean((2, 3)), features.amax((2, 3))], 1)  # (b, 2 c)
        out = self.head(pooled).float()  # (b, 2)
        log_scale = out[:, 1].clamp(-s.log_scale_limit, s.log_scale_limit) - 1
        return out[:, 0] + s.first_log_ratio, log_scale

    def loss(self, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Laplace's negative log likelihood of crops `x`; `y`: (b,) logs of the ratios."""
        mean, log_scale = self(x)
        return (torch.abs(y - mean) * torch.exp(-log_scale) + log_scale).mean()


def save_wall_net(path: Path, net: WallNet, facts: dict[str, str]) -> None:
    """Writes weights as float16, with their graph; `facts` become metadata of the file.

    Raises:
        WeightsError: ONNX Runtime gives other values than torch.
    """
    tensors = {name: value.half().cpu().numpy() for name, value in net.state_dict().items()
               if not name.endswith("num_batches_tracked")}
    graph = export_graph(net.eval(), {"crops": (CHANNELS, SIDE, SIDE)})
    write_weights(path, FORMAT, {**tensors, GRAPH: graph}, facts)
