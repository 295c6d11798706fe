"""The gamma-network: a small residual encoder that pools by what stands in each place.

gamma is parts' volume over V, and both are integrals over the footprint: features are averaged
with the height of the stack as weight. The network gives log gamma and the scale of its error
(Laplace); while it learns it also gives the part's size, convexity and surface, in l, which are
what gamma depends on.
"""

from __future__ import annotations

import json
import zlib
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file
from torch import nn
from torch.nn import functional

from stack_counter.errors import WeightsError
from stack_counter.occupancy.maps import CHANNELS

FORMAT = "stack_counter gamma 1"
TUNING = "stack_counter tuning 1"
SHAPE_OUTPUTS = 3  # log part size, convexity and surface: learnt beside gamma
_SCALARS = 3
_DOWN = 16  # of the feature map


@dataclass(frozen=True)
class NetConfig:
    """Widths of the stages, at strides 2, 4, 8 and 16, residual blocks of each, width of the head,
    whether features are averaged by height (else every place counts alike), and at how many
    scales, each half as fine, the tile is read.
    """

    widths: tuple[int, ...] = (32, 64, 96, 128)
    blocks: tuple[int, ...] = (1, 2, 2, 2)
    hidden: int = 128
    by_height: bool = True
    scales: int = 1


class Block(nn.Module):
    """Two 3x3 convolutions beside a shortcut."""

    def __init__(self, width: int):
        super().__init__()
        self.body = nn.Sequential(
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width), nn.ReLU(),
            nn.Conv2d(width, width, 3, padding=1, bias=False), nn.BatchNorm2d(width))

    def forward(self, x: torch.Tensor) -> torch.Tensor:
        """(b, width, h, w) -> the same."""
        return functional.relu(x + self.body(x))


class GammaNet(nn.Module):
    """(b, CHANNELS, TILE, TILE) -> log gamma, log scale, form."""

    def __init__(self, config: NetConfig):
        super().__init__()
        self.config = config
        layers: list[nn.Module] = []
        width_in = CHANNELS
        for width, blocks in zip(config.widths, config.blocks):
            layers += [nn.Conv2d(width_in, width, 4, 2, 1, bias=False), nn.BatchNorm2d(width),
                       nn.ReLU(), *(Block(width) for _ in range(blocks))]
            width_in = width
        self.encoder = nn.Sequential(*layers)
        self.head = nn.Sequential(
            nn.Linear(2 * width_in * config.scales + _SCALARS, config.hidden), nn.ReLU(),
            nn.Dropout(0.2), nn.Linear(config.hidden, 2 + SHAPE_OUTPUTS))

    def forward(self, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """(b, CHANNELS, h, w) float32 of `channels` -> log gamma (b,), log of the scale of its
        error (b,), form (b, FORM).
        """
        height = torch.expm1(2 * x[:, 3:4])  # (b, 1, h, w), l
        pooled = [self._pooled(x if i == 0 else functional.avg_pool2d(x, 2**i))
                  for i in range(self.config.scales)]
        valid = x[:, 1].mean((1, 2)).clamp_min(1e-4)
        scalars = torch.stack([torch.log(height.mean((1, 2, 3)) / valid + 0.05),
                               torch.log(valid), x[:, 2].mean((1, 2)) / valid], 1)
        out = self.head(torch.cat([*pooled, scalars], 1)).float()
        return out[:, 0] - 0.7, out[:, 1].clamp(-2, 2) - 2, out[:, 2:]

    def _pooled(self, x: torch.Tensor) -> torch.Tensor:
        """(b, CHANNELS, h, w) -> (b, 2 c): mean and deviation of the features."""
        height = torch.expm1(2 * x[:, 3:4])
        features = self.encoder(x).float()  # (b, c, h / 16, w / 16)
        weight = functional.avg_pool2d(height * self.config.by_height + 0.02 * x[:, 1:2], _DOWN)
        weight = functional.adaptive_avg_pool2d(weight, features.shape[2:])
        weight = weight / weight.sum((2, 3), keepdim=True).clamp_min(1e-6)
        mean = (features * weight).sum((2, 3))
        spread = ((features - mean[:, :, None, None]) ** 2 * weight).sum((2, 3))
        return torch.cat([mean, torch.sqrt(spread + 1e-4)], 1)

    def loss(self, x: torch.Tensor, y: torch.Tensor, likelihood: bool = True,
             form_weight: float = 0.1) -> torch.Tensor:
        """Laplace's negative log likelihood of log gamma, and the form's squared error.

        Args:
            x: as for `forward`.
            y: (b, 1 + FORM) log gamma and form.
            likelihood: False: squared error, which knows no spread.
            form_weight: of the form's error.
        """
        mean, scale, form = self(x)
        miss = y[:, 0] - mean
        fit = (torch.abs(miss) * torch.exp(-scale) + scale).mean() if likelihood \
            else (miss**2).mean()
        return fit + form_weight * ((form - y[:, 1:]) ** 2).mean()


def make_net(encoder: str, folder: Path | None) -> nn.Module:
    """An untrained network: `own`, or `dinov2` with the encoder from a folder of the user's.

    Raises:
        WeightsError: the folder cannot be loaded, or is missing for `dinov2`.
    """
    if encoder == "own":
        return GammaNet(NetConfig())
    if folder is None:
        raise WeightsError("the encoder is DINOv2 and no folder with its weights is named; "
                           "expected one")
    from stack_counter.occupancy.dino_net import DinoNet  # needs transformers

    return DinoNet(folder)


def save_members(path: Path, members: Sequence[nn.Module], facts: dict[str, str],
                 more: dict[str, torch.Tensor]) -> None:
    """Writes an ensemble of equal networks; `facts` and tensors `more` travel with it. Of a
    network with DINOv2 the decoder alone is written: the encoder is the user's.
    """
    first = members[0]
    config = {"encoder": "own", **asdict(first.config)} if isinstance(first, GammaNet) \
        else {"encoder": "dinov2"}
    tensors = {f"{i}.{name}": value.half() if value.is_floating_point() else value
               for i, net in enumerate(members) for name, value in net.state_dict().items()
               if _is_own(net, name)}
    tensors |= {f"calibration.{name}": value for name, value in more.items()}
    save_file({name: value.contiguous() for name, value in tensors.items()}, path, metadata={
        "format": FORMAT, "config": json.dumps(config), "members": str(len(members)), **facts})


def load_members(path: Path, encoder_folder: Path | None = None
                 ) -> tuple[list[nn.Module], dict[str, str], dict[str, torch.Tensor]]:
    """Networks in evaluation mode, facts and further tensors of a file of `save_members`.

    Args:
        path: safetensors file.
        encoder_folder: of DINOv2, if the file's networks were trained upon it.

    Raises:
        WeightsError: missing, not safetensors, of another format, or not whole.
    """
    if not path.is_file():
        raise WeightsError(f"no weights file {path}; expected a safetensors file")
    try:
        with safe_open(path, framework="pt") as file:
            facts = dict(file.metadata() or {})
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is not a whole safetensors file: {error}") from error
    if facts.get("format") != FORMAT:
        raise WeightsError(f"{path} is '{facts.get('format')}'; expected '{FORMAT}'")
    try:
        config = json.loads(facts["config"])
        members = [_member(config, encoder_folder, tensors, i)
                   for i in range(int(facts["members"]))]
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise WeightsError(f"{path} does not hold the networks it names: "
                           f"{' '.join(str(error).split())[:200]}") from error
    more = {name.removeprefix("calibration."): value for name, value in tensors.items()
            if name.startswith("calibration.")}
    return members, facts, more


def _is_own(net: nn.Module, name: str) -> bool:
    """Whether a tensor is written: not a counter, and not a frozen encoder's."""
    return not name.endswith("num_batches_tracked") and (
        isinstance(net, GammaNet) or not name.startswith("encoder."))


def _member(config: dict, encoder_folder: Path | None, tensors: dict[str, torch.Tensor],
            number: int) -> nn.Module:
    net: nn.Module
    if config["encoder"] == "own":
        net = GammaNet(NetConfig(tuple(config["widths"]), tuple(config["blocks"]),
                                 config["hidden"], config.get("by_height", True),
                                 config.get("scales", 1)))
    else:
        net = make_net(config["encoder"], encoder_folder)
    prefix = f"{number}."
    own = {name.removeprefix(prefix): value.float() for name, value in tensors.items()
           if name.startswith(prefix)}
    if not all(bool(torch.isfinite(value).all()) for value in own.values()):
        raise ValueError(f"member {number} holds NaN; expected finite numbers")
    result = net.load_state_dict(own, strict=False)
    lacking = [name for name in result.missing_keys if _is_own(net, name)]
    if lacking or result.unexpected_keys:
        raise ValueError(f"member {number} lacks {lacking[:3]}, has {result.unexpected_keys[:3]}")
    return net.eval()


def save_tuning(path: Path, weight: np.ndarray, bias: float, of: str) -> None:
    """Writes changes of the members' last layers: of log gamma's weights (members, h) and bias;
    `of` is the network's name.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({"weight": torch.from_numpy(weight), "bias": torch.tensor([bias]).double()}, path,
              metadata={"format": TUNING, "of": of})


def tuned_name(of: str, weight: np.ndarray, bias: float) -> str:
    """What a network is called with such changes: other piles, another name."""
    return f"{of}, tuned {zlib.crc32(np.append(weight, bias).tobytes()):08x}"


def read_tuning(path: Path) -> tuple[np.ndarray, float, str]:
    """What `save_tuning` wrote.

    Raises:
        WeightsError: missing, not safetensors or of another format.
    """
    try:
        with safe_open(path, framework="pt") as file:
            facts = dict(file.metadata() or {})
            if facts.get("format") != TUNING:
                raise WeightsError(f"{path} is '{facts.get('format')}'; expected '{TUNING}'")
            return (file.get_tensor("weight").numpy(), float(file.get_tensor("bias")),
                    facts["of"])
    except (SafetensorError, OSError) as error:
        raise WeightsError(f"{path} is no whole safetensors file: {error}") from error
