# SPDX-License-Identifier: Apache-2.0
"""Files of the trained baselines: safetensors with the network's settings."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any, TypeVar

import torch
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.files import read_weights, write_weights

FORMAT = "stack_counter picture baseline 1"
Net = TypeVar("Net", bound=nn.Module)


def save_net(path: Path, baseline: str, net: nn.Module, facts: Mapping[str, str],
             without: str = "") -> None:
    """Writes a network whose settings are the dataclass `net.config`.

    Args:
        path: safetensors file.
        baseline: key of `KINDS`.
        net: what is written.
        facts: texts for the metadata, such as what it was trained on.
        without: tensors whose names begin so are left out: the user has them; "": none.
    """
    tensors = {name: value.cpu().numpy() for name, value in net.state_dict().items()
               if not (without and name.startswith(without))}
    write_weights(path, FORMAT, tensors, {"baseline": baseline,
                                          "config": json.dumps(asdict(net.config)), **facts})


def read_net(path: Path, baseline: str, make: Callable[[dict[str, Any]], Net]) -> Net:
    """Reads what `save_net` has written, in evaluation mode.

    Args:
        path: safetensors file.
        baseline: key of `KINDS` that it must be of.
        make: builds the untrained network of its settings.

    Raises:
        WeightsError: the file is missing, damaged, of another baseline or not whole.
    """
    file = read_weights(path, FORMAT)
    if file.metadata.get("baseline") != baseline:
        raise WeightsError(f"{path} is of the baseline '{file.metadata.get('baseline')}'; "
                           f"expected '{baseline}'")
    try:
        net = make(dict(json.loads(file.metadata["config"])))
        result = net.load_state_dict({name: torch.from_numpy(values) for name, values in
                                      file.tensors.items()}, strict=False)
    except (KeyError, TypeError, ValueError, RuntimeError) as error:
        raise WeightsError(f"{path} does not hold the network it names: "
                           f"{' '.join(str(error).split())[:200]}") from error
    frozen = {name for name, value in net.named_parameters() if not value.requires_grad}
    lacking = [name for name in result.missing_keys if name not in frozen]
    if lacking or result.unexpected_keys:
        raise WeightsError(f"{path} lacks {lacking[:3]} and has {result.unexpected_keys[:3]} too "
                           "many; expected the tensors of its network")
    return net.eval()
