# SPDX-License-Identifier: Apache-2.0
"""Weights files: ensembles of networks with their calibration, and last layers tuned to a part."""

from __future__ import annotations

import json
import zlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.torch import save_file
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.files import read_weights
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.types import KnownLevel

FORMAT = "stack_counter gamma 1"
TUNING_FORMAT = "stack_counter tuning 1"
_CALIBRATION = "calibration."


@dataclass(frozen=True, eq=False)
class Checkpoint:
    """Content of a weights file.

    Attributes:
        members: networks of the ensemble, in evaluation mode.
        facts: texts of the file's metadata, such as `version`.
        calibration: float64 arrays by name.
    """

    members: list[nn.Module]
    facts: dict[str, str]
    calibration: dict[str, np.ndarray]


@dataclass(frozen=True, eq=False)
class LastLayerTuning:
    """Changes of an ensemble's last layers that adapt it to one part.

    Attributes:
        weight: (members, h) float64, added to the weights of log gamma.
        bias: added to the bias of log gamma.
        network_name: name of the network that they belong to.
    """

    weight: np.ndarray
    bias: float
    network_name: str


def make_net(encoder: str, folder: Path | None) -> nn.Module:
    """Builds an untrained network: `own`, or `dinov2` with the encoder from the user's folder.

    Raises:
        WeightsError: the folder cannot be loaded, or is missing for `dinov2`.
    """
    if encoder == "own":
        return GammaNet(NetConfig(knows_form=True, knows_resolution=True))
    if folder is None:
        raise WeightsError("the encoder is DINOv2 and no folder with its weights is named; "
                           "expected one")
    from stack_counter.occupancy.dino_net import DinoNet  # needs transformers

    return DinoNet(folder)


def save_members(path: Path, members: Sequence[nn.Module], facts: Mapping[str, str],
                 calibration: Mapping[str, np.ndarray]) -> None:
    """Writes an ensemble of equal networks.

    Of a network with DINOv2 the decoder alone is written: the encoder is the user's.

    Args:
        path: safetensors file.
        members: networks, kept in half precision.
        facts: texts for the metadata.
        calibration: arrays by name, kept in their own precision.
    """
    first = members[0]
    config = {"encoder": "own", **asdict(first.config)} if isinstance(first, GammaNet) \
        else {"encoder": "dinov2"}
    tensors = {f"{i}.{name}": value.half() if value.is_floating_point() else value
               for i, net in enumerate(members) for name, value in net.state_dict().items()
               if _is_stored(net, name)}
    tensors |= {_CALIBRATION + name: torch.from_numpy(np.asarray(values))
                for name, values in calibration.items()}
    save_file({name: value.contiguous() for name, value in tensors.items()}, path, metadata={
        "format": FORMAT, "config": json.dumps(config), "members": str(len(members)), **facts})


def load_members(path: Path, encoder_folder: Path | None = None) -> Checkpoint:
    """Reads what `save_members` has written.

    Args:
        path: safetensors file.
        encoder_folder: folder of DINOv2, if the networks were trained upon it.

    Raises:
        WeightsError: the file is missing, not safetensors, of another format, or not whole.
    """
    file = read_weights(path, FORMAT)
    tensors = {name: torch.from_numpy(values) for name, values in file.tensors.items()}
    try:
        config = json.loads(file.metadata["config"])
        members = [_load_member(config, encoder_folder, tensors, i)
                   for i in range(int(file.metadata["members"]))]
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise WeightsError(f"{path} does not hold the networks it names: "
                           f"{' '.join(str(error).split())[:200]}") from error
    calibration = {name.removeprefix(_CALIBRATION): values.astype(float)
                   for name, values in file.tensors.items() if name.startswith(_CALIBRATION)}
    return Checkpoint(members, file.metadata, calibration)


def save_tuning(path: Path, weight: np.ndarray, bias: float, network_name: str) -> None:
    """Writes a `LastLayerTuning`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    save_file({"weight": torch.from_numpy(weight), "bias": torch.tensor([bias]).double()}, path,
              metadata={"format": TUNING_FORMAT, "of": network_name})


def read_tuning(path: Path) -> LastLayerTuning:
    """Reads what `save_tuning` has written.

    Raises:
        WeightsError: the file is missing, not safetensors, of another format, or not whole.
    """
    file = read_weights(path, TUNING_FORMAT)
    try:
        return LastLayerTuning(file.tensors["weight"], float(file.tensors["bias"][0]),
                               file.metadata["of"])
    except (KeyError, IndexError) as error:
        raise WeightsError(f"{path} holds {sorted(file.tensors)}; expected weight, bias and the "
                           "name of their network") from error


def knowing_name(network_name: str, level: KnownLevel) -> str:
    """Names a network as it estimates parts of whose form so much is known."""
    return f"{network_name}, {level.name.lower()} known" if level else network_name


def tuned_name(network_name: str, weight: np.ndarray, bias: float) -> str:
    """Names a network with tuned last layers: other changes, another name."""
    return f"{network_name}, tuned {zlib.crc32(np.append(weight, bias).tobytes()):08x}"


def _is_stored(net: nn.Module, name: str) -> bool:
    """Whether a tensor is written: not a counter, and not a frozen encoder's."""
    return not name.endswith("num_batches_tracked") and (
        isinstance(net, GammaNet) or not name.startswith("encoder."))


def _load_member(config: dict[str, Any], encoder_folder: Path | None,
                 tensors: Mapping[str, torch.Tensor], number: int) -> nn.Module:
    """Builds one network and fills it.

    Raises:
        KeyError, TypeError: the configuration lacks a setting or holds one of another type.
        RuntimeError, ValueError: the tensors are not those of that architecture.
    """
    net: nn.Module
    if config["encoder"] == "own":
        net = GammaNet(NetConfig(tuple(config["widths"]), tuple(config["blocks"]),
                                 config["hidden"], config.get("by_height", True),
                                 config.get("scales", 1), config.get("knows_form", False),
                                 config.get("knows_resolution", False)))
    else:
        net = make_net(config["encoder"], encoder_folder)
    prefix = f"{number}."
    state = {name.removeprefix(prefix): value.float() for name, value in tensors.items()
             if name.startswith(prefix)}
    result = net.load_state_dict(state, strict=False)
    lacking = [name for name in result.missing_keys if _is_stored(net, name)]
    if lacking or result.unexpected_keys:
        raise ValueError(f"member {number} lacks {lacking[:3]}, has {result.unexpected_keys[:3]}")
    return net.eval()
