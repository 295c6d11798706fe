# SPDX-License-Identifier: Apache-2.0
"""Ensembles of networks in torch, and their files with the calibration."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.files import write_weights
from stack_counter.inference import GRAPH
from stack_counter.occupancy.ensemble import EnsembleOutput
from stack_counter.occupancy.gamma_net import GammaNet, NetConfig
from stack_counter.occupancy.weights_file import (
    CALIBRATION,
    FORMAT,
    read_network_file,
    unlike_its_networks,
)

SHIPPED_NET = NetConfig(knows_form=True, knows_resolution=True)


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


class TorchEnsemble:
    """Runs networks by torch: those that are trained, and those upon the user's encoder."""

    def __init__(self, members: Sequence[nn.Module]):
        """`members`: networks, in evaluation mode."""
        self._members = members

    def __call__(self, tiles: np.ndarray, known: np.ndarray, resolution: np.ndarray
                 ) -> EnsembleOutput:
        """Estimates tiles."""
        numbers = [torch.from_numpy(values).expand(len(tiles), -1)
                   for values in (known, resolution)]
        with torch.inference_mode():
            outputs = [net(torch.from_numpy(tiles), *numbers) for net in self._members]
        return EnsembleOutput(*(np.stack([values.numpy() for values in field])
                                for field in zip(*outputs)))


def make_net(encoder: str, folder: Path | None) -> nn.Module:
    """Builds an untrained network: `own`, or `dinov2` with the encoder from the user's folder.

    Raises:
        WeightsError: the folder cannot be loaded, or is missing for `dinov2`.
    """
    if encoder == "own":
        return GammaNet(SHIPPED_NET)
    if folder is None:
        raise WeightsError("the encoder is DINOv2 and no folder with its weights is named; "
                           "expected one")
    from stack_counter.occupancy.dino_net import DinoNet  # needs transformers

    return DinoNet(folder)


def save_members(path: Path, members: Sequence[nn.Module], facts: Mapping[str, str],
                 calibration: Mapping[str, np.ndarray], graph: np.ndarray | None = None) -> None:
    """Writes an ensemble of equal networks.

    Of a network with DINOv2 the decoder alone is written: the encoder is the user's.

    Args:
        path: safetensors file.
        members: networks, kept in half precision.
        facts: texts for the metadata.
        calibration: arrays by name, kept in their own precision.
        graph: of the networks, (n,) uint8, as `train.onnx_export` gives it; None: only torch can
            run them.
    """
    first = members[0]
    config = {"encoder": "own", **asdict(first.config)} if isinstance(first, GammaNet) \
        else {"encoder": "dinov2"}
    tensors = {f"{i}.{name}": (value.half() if value.is_floating_point() else value).cpu().numpy()
               for i, net in enumerate(members) for name, value in net.state_dict().items()
               if _is_stored(net, name)}
    tensors |= {CALIBRATION + name: np.asarray(values) for name, values in calibration.items()}
    if graph is not None:
        tensors[GRAPH] = graph
    write_weights(path, FORMAT, tensors, {"config": json.dumps(config),
                                          "members": str(len(members)), **facts})


def load_members(path: Path, encoder_folder: Path | None = None) -> Checkpoint:
    """Reads what `save_members` has written.

    Args:
        path: safetensors file.
        encoder_folder: folder of DINOv2, if the networks were trained upon it.

    Raises:
        WeightsError: the file is missing, not safetensors, of another format, or not whole.
    """
    file = read_network_file(path)
    tensors = {name: torch.from_numpy(values) for name, values in file.tensors.items()}
    try:
        members = [_load_member(file.config, encoder_folder, tensors, i)
                   for i in range(file.members)]
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise unlike_its_networks(path, error) from error
    return Checkpoint(members, file.facts, file.calibration)


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
