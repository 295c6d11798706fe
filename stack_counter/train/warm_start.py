# SPDX-License-Identifier: Apache-2.0
"""Members that go on from those of an earlier weights file instead of learning from nothing."""

from __future__ import annotations

import json
from pathlib import Path

import torch
from torch import nn

from stack_counter.errors import ConfigError
from stack_counter.occupancy.checkpoint import load_members


def begin_as_member(net: nn.Module, path: Path, fold: int) -> None:
    """Gives an untrained network the weights of the member of a file that left out the same fold.

    Layers that the earlier network lacks stay as they are; those that read more inputs than it
    did read nothing of these at first.

    Args:
        net: untrained.
        path: weights file; folds are as the families of its training were dealt, those of each
            source apart.
        fold: number of the fold of families that the network must not have seen.

    Raises:
        ConfigError: the file has no member of that fold, or one of another architecture.
        WeightsError: the file cannot be read.
    """
    checkpoint = load_members(path)
    # Files written before they named their folds hold the members of the first ones.
    folds = json.loads(checkpoint.facts.get("folds", str([*range(len(checkpoint.members))])))
    if fold not in folds:
        raise ConfigError(f"--start {path}: members of folds {folds}; expected one of fold {fold}:"
                          f" ask for --folds {' '.join(map(str, folds))}")
    earlier = checkpoint.members[folds.index(fold)].state_dict()
    state = net.state_dict()
    for name, values in earlier.items():
        state[name] = _widen_inputs(values, state[name]) if name in state else values
    try:
        net.load_state_dict(state)
    except RuntimeError as error:
        raise ConfigError(f"--start {path}: {' '.join(str(error).split())[:200]}; expected a "
                          "network of the same encoder and widths") from error


def _widen_inputs(earlier: torch.Tensor, like: torch.Tensor) -> torch.Tensor:
    """A linear layer's weights with zeros for the inputs that `like` has more; else unchanged."""
    if earlier.ndim != 2 or like.ndim != 2 or earlier.shape[1] >= like.shape[1]:
        return earlier
    return nn.functional.pad(earlier, (0, like.shape[1] - earlier.shape[1]))
