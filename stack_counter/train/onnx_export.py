# SPDX-License-Identifier: Apache-2.0
"""The graph of a trained network, for ONNX Runtime: `inference` runs it.

The graph has no weights: the file that keeps it has them beside it, in half precision.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx
import torch
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.inference import GRAPH, NetworkSession
from stack_counter.occupancy.known_form import KNOWN_VALUES
from stack_counter.occupancy.maps import CHANNELS, TILE
from stack_counter.occupancy.resolution import RESOLUTION_VALUES


@dataclass(frozen=True)
class OnnxExportSettings:
    """How a graph is checked.

    Attributes:
        max_difference: largest difference of an output from torch's, relative for values above
            1; chosen. Measured for the shipped networks: 5e-7.
        batch: number of random inputs for which outputs are compared; chosen.
    """

    max_difference: float = 1e-5
    batch: int = 4


SETTINGS = OnnxExportSettings()


class StackedNets(nn.ModuleList):
    """Networks as one, of which the weights are named as in their file."""

    def forward(self, tiles: torch.Tensor, known: torch.Tensor, resolution: torch.Tensor
                ) -> tuple[torch.Tensor, ...]:
        """Returns the fields of `EnsembleOutput`."""
        return tuple(torch.stack(outputs)
                     for outputs in zip(*(net(tiles, known, resolution) for net in self)))


# Inputs of an ensemble's graph by name, without the batch.
INPUTS = {"tiles": (CHANNELS, TILE, TILE), "known": (KNOWN_VALUES,),
          "resolution": (RESOLUTION_VALUES,)}


def export_ensemble(members: Sequence[nn.Module]) -> np.ndarray:
    """Exports gamma-networks of our own, in evaluation mode, as `OnnxEnsemble` runs them.

    Raises:
        WeightsError: as for `check_graph`.
    """
    return export_graph(StackedNets(members).eval(), INPUTS)


def export_graph(net: nn.Module, shapes: Mapping[str, Sequence[int]], stride: int = 0
                 ) -> np.ndarray:
    """Exports a network, and checks what ONNX Runtime makes of it.

    Args:
        net: in evaluation mode; it takes the inputs in their order, and gives several outputs.
        shapes: of an input without its batch, by name.
        stride: of a network that takes maps of any size: of what their last two sides are
            multiples; 0: they are fixed.

    Returns:
        (n,) uint8, the graph for any size of the batch.

    Raises:
        WeightsError: as for `check_graph`.
    """
    dynamic = {0: torch.export.Dim("batch")}
    if stride:
        dynamic |= {axis: stride * torch.export.Dim(f"cells_{axis}") for axis in (2, 3)}
    program = torch.onnx.export(
        net, tuple(map(torch.from_numpy, _random_inputs(shapes).values())), dynamo=True,
        optimize=False, verbose=False, input_names=list(shapes),
        dynamic_shapes=tuple(dynamic for _ in shapes))
    graph = _without_weights(program.model_proto, set(net.state_dict()))
    check_graph(graph, net, shapes)
    return graph


def check_graph(graph: np.ndarray, net: nn.Module, shapes: Mapping[str, Sequence[int]]) -> None:
    """Compares what ONNX Runtime gives for a graph with what the network gives by torch.

    Raises:
        WeightsError: the values differ.
    """
    inputs = _random_inputs(shapes)
    weights = {name: values.numpy() for name, values in net.state_dict().items()
               if not name.endswith("num_batches_tracked")}
    session = NetworkSession(Path("the network"), {GRAPH: graph, **weights})
    with torch.inference_mode():
        expected = net(*map(torch.from_numpy, inputs.values()))
    difference = max(float((np.abs(ours.numpy() - theirs)
                            / np.maximum(np.abs(theirs), 1)).max(initial=0))
                     for ours, theirs in zip(expected, session(**inputs)))
    if not difference <= SETTINGS.max_difference:
        raise WeightsError(f"ONNX Runtime differs by {difference:.2g} from torch; expected at "
                           f"most {SETTINGS.max_difference:g}")


def _random_inputs(shapes: Mapping[str, Sequence[int]]) -> dict[str, np.ndarray]:
    """Inputs of these shapes, float32 from 0 to 1, always the same."""
    random = np.random.default_rng(0)
    return {name: random.random((SETTINGS.batch, *shape), np.float32)
            for name, shape in shapes.items()}


def _without_weights(model: onnx.ModelProto, names: set[str]) -> np.ndarray:
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
    return np.frombuffer(model.SerializeToString(), np.uint8)
