# SPDX-License-Identifier: Apache-2.0
"""Files of networks and of last layers tuned to a part, as far as they take no torch."""

from __future__ import annotations

import json
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from stack_counter.errors import WeightsError
from stack_counter.files import read_weights, write_weights
from stack_counter.types import KnownLevel

FORMAT = "stack_counter gamma 1"
TUNING_FORMAT = "stack_counter tuning 1"
CALIBRATION = "calibration."  # what the names of calibration tensors begin with


@dataclass(frozen=True, eq=False)
class NetworkFile:
    """Content of a file of an ensemble of networks.

    Attributes:
        config: the networks' architecture, `encoder` among it.
        members: number of networks.
        tensors: their weights by name, which begins with the member's number; and their graph,
            if ONNX Runtime can run them.
        facts: texts of the file's metadata, such as `version`.
        calibration: float64 arrays by name.
    """

    config: dict[str, Any]
    members: int
    tensors: dict[str, np.ndarray]
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


def read_network_file(path: Path) -> NetworkFile:
    """Reads what `checkpoint.save_members` has written.

    Raises:
        WeightsError: the file is missing, not safetensors, of another format, or does not say
            what networks it holds.
    """
    file = read_weights(path, FORMAT)
    try:
        config, members = dict(json.loads(file.metadata["config"])), int(file.metadata["members"])
    except (KeyError, TypeError, ValueError) as error:
        raise unlike_its_networks(path, error) from error
    calibration = {name.removeprefix(CALIBRATION): values.astype(float)
                   for name, values in file.tensors.items() if name.startswith(CALIBRATION)}
    weights = {name: values for name, values in file.tensors.items()
               if not name.startswith(CALIBRATION)}
    return NetworkFile(config, members, weights, file.metadata, calibration)


def unlike_its_networks(path: Path, error: Exception) -> WeightsError:
    """Returns the error of a file that lacks what its networks need; `error` says what."""
    return WeightsError(f"{path} does not hold the networks it names: "
                        f"{' '.join(str(error).split())[:200]}")


def save_tuning(path: Path, weight: np.ndarray, bias: float, network_name: str) -> None:
    """Writes a `LastLayerTuning`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_weights(path, TUNING_FORMAT, {"weight": weight, "bias": np.array([bias])},
                  {"of": network_name})


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
