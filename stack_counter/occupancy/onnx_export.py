# SPDX-License-Identifier: Apache-2.0
"""The graph of an ensemble as ONNX Runtime reads it, written where networks are trained.

The graph has no weights: the file that keeps it has them beside it, in half precision.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import onnx
import torch
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.occupancy.ensemble import EnsembleOutput, OnnxEnsemble
from stack_counter.occupancy.maps import CHANNELS, TILE


@dataclass(frozen=True)
class OnnxExportSettings:
    """How a graph is written and checked.

    Attributes:
        max_difference: largest difference of an output from torch's; chosen. Measured for the
            shipped network: 5e-7.
        checked_tiles: tiles for which outputs are compared; chosen.
    """

    max_difference: float = 1e-5
    checked_tiles: int = 4


SETTINGS = OnnxExportSettings()


class _Ensemble(nn.ModuleList):
    """Networks as one, of which the weights are named as in their file."""

    def forward(self, tiles: torch.Tensor) -> tuple[torch.Tensor, ...]:
        """Returns the fields of `EnsembleOutput`."""
        return tuple(torch.stack(outputs) for outputs in zip(*(net(tiles) for net in self)))


def export_graph(members: Sequence[nn.Module]) -> bytes:
    """Writes the graph of an ensemble, and checks it.

    Args:
        members: networks of our own, in evaluation mode.

    Raises:
        WeightsError: as for `check_graph`.
    """
    ensemble = _Ensemble(members).eval()
    program = torch.onnx.export(
        ensemble, (torch.from_numpy(_random_tiles()),), dynamo=True, optimize=False, verbose=False,
        dynamic_shapes=({0: torch.export.Dim("tiles")},), input_names=["tiles"],
        output_names=list(EnsembleOutput._fields))
    graph = _without_weights(program.model_proto, set(ensemble.state_dict()))
    check_graph(graph, members)
    return graph


def check_graph(graph: bytes, members: Sequence[nn.Module]) -> None:
    """Compares what ONNX Runtime gives for a graph with what the networks give.

    Raises:
        WeightsError: the values differ.
    """
    ensemble, tiles = _Ensemble(members).eval(), _random_tiles()
    weights = {name: values.numpy() for name, values in ensemble.state_dict().items()
               if not name.endswith("num_batches_tracked")}
    with torch.inference_mode():
        expected = ensemble(torch.from_numpy(tiles))
    for name, ours, theirs in zip(EnsembleOutput._fields, expected,
                                  OnnxEnsemble(graph, weights)(tiles)):
        difference = float(np.abs(ours.numpy() - theirs).max(initial=0))
        if not difference <= SETTINGS.max_difference:
            raise WeightsError(f"ONNX Runtime's {name} differs by {difference:.2g} from torch's; "
                               f"expected at most {SETTINGS.max_difference:g}")


def _random_tiles() -> np.ndarray:
    """(checked_tiles, CHANNELS, TILE, TILE) float32, always the same."""
    return np.random.default_rng(0).random(
        (SETTINGS.checked_tiles, CHANNELS, TILE, TILE), np.float32)


def _without_weights(model: onnx.ModelProto, names: set[str]) -> bytes:
    """Returns a model whose weights of these names are to be handed over, and without notes."""
    for tensor in model.graph.initializer:
        if tensor.name in names:
            tensor.ClearField("raw_data")
            tensor.data_location = onnx.TensorProto.EXTERNAL
            tensor.external_data.add(key="location", value="weights")
    for node in model.graph.node:
        node.ClearField("metadata_props")
        node.ClearField("doc_string")
    model.graph.ClearField("value_info")
    return model.SerializeToString()
