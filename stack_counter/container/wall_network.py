"""Psi: the thickness of a container's wall as a share of its width, from crops of its views.

Source: paper, section 3.3: dilated convolutions, a ratio of the container's size, averaged over
the views. It speaks where geometry cannot measure the wall: where parts hide the rim's inner edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from importlib import resources
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn

from stack_counter.container.wall_input import CHANNELS, outer_width, wall_crop
from stack_counter.container.wall_shapes import WallShape
from stack_counter.errors import ViewError, WeightsError
from stack_counter.types import View

SHIPPED = "wall.safetensors"
FORMAT = "stack_counter wall 1"
_WIDTH = 32
_DILATIONS = (1, 2, 4, 8)
_MOST_VIEWS = 6  # looked at, evenly spread over the scan


class WallNet(nn.Module):
    """(b, CHANNELS, SIDE, SIDE) -> log of thickness over width, log of the scale of its error."""

    def __init__(self) -> None:
        super().__init__()
        layers: list[nn.Module] = [nn.Conv2d(CHANNELS, _WIDTH, 4, 2, 1, bias=False),
                                   nn.BatchNorm2d(_WIDTH), nn.ReLU()]
        for dilation in _DILATIONS:
            layers += [nn.Conv2d(_WIDTH, _WIDTH, 3, 1, dilation, dilation, bias=False),
                       nn.BatchNorm2d(_WIDTH), nn.ReLU()]
        self.encoder = nn.Sequential(*layers)
        self.head = nn.Sequential(nn.Linear(2 * _WIDTH, 64), nn.ReLU(), nn.Dropout(0.1),
                                  nn.Linear(64, 2))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """(b, CHANNELS, h, w) float32 -> (b,), (b,)."""
        features = self.encoder(x).float()  # (b, c, h / 2, w / 2)
        pooled = torch.cat([features.mean((2, 3)), features.amax((2, 3))], 1)
        out = self.head(pooled).float()
        return out[:, 0] - 3.5, out[:, 1].clamp(-3, 3) - 1

    def loss(self, x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
        """Laplace's negative log likelihood; `y`: (b,) log of thickness over width."""
        mean, scale = self(x)
        return (torch.abs(y - mean) * torch.exp(-scale) + scale).mean()


def save_wall_net(path: Path, net: WallNet, facts: dict[str, str]) -> None:
    """Writes what `load_wall_net` reads."""
    tensors = {name: value.half() for name, value in net.state_dict().items()
               if not name.endswith("num_batches_tracked")}
    save_file(tensors, path, metadata={"format": FORMAT, **facts})


@cache
def load_wall_net(path: Path | None = None) -> WallNet:
    """The network in evaluation mode; None is the file shipped with the package.

    Raises:
        WeightsError: missing, not safetensors, of another format or not whole.
    """
    path = path or Path(str(resources.files("stack_counter") / "weights" / SHIPPED))
    if not path.is_file():
        raise WeightsError(f"no weights file {path}; expected a safetensors file")
    try:
        with safe_open(path, framework="pt") as file:
            kind = (file.metadata() or {}).get("format")
            tensors = {name: file.get_tensor(name).float() for name in file.keys()}
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is not a whole safetensors file: {error}") from error
    if kind != FORMAT:
        raise WeightsError(f"{path} is '{kind}'; expected '{FORMAT}'")
    net = WallNet()
    try:
        net.load_state_dict(tensors, strict=False)
    except RuntimeError as error:
        raise WeightsError(f"{path} does not hold the network it names: "
                           f"{' '.join(str(error).split())[:200]}") from error
    return net.eval()


def estimate_wall(views: Sequence[View], form: WallShape, height: float, plane_z: float,
                  net: WallNet | None = None) -> tuple[float, float] | None:
    """Thickness and its standard deviation, metres; None where no view shows the container.

    Args:
        views: with depth.
        form: outer face of the wall, world frame.
        height: of the rim over the support plane at `plane_z`, metres.
        net: None is the shipped one.
    """
    chosen = np.unique(np.linspace(0, len(views) - 1, _MOST_VIEWS).round().astype(int))
    crops = []
    for i in chosen:
        try:
            crops.append(wall_crop(views[i], form, height, plane_z))
        except ViewError:
            continue  # another view shows it
    if not crops:
        return None
    with torch.inference_mode():
        mean, scale = (net or load_wall_net())(torch.from_numpy(np.stack(crops)))
    thickness = float(torch.exp(mean).mean()) * outer_width(form)
    return thickness, float(np.sqrt(2) * torch.exp(scale).mean()) * thickness
