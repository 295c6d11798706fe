# SPDX-License-Identifier: Apache-2.0
"""Trained networks as ONNX Runtime runs them: without torch, which takes seconds to load.

The file of a network keeps its graph, which training has exported, beside its weights.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from stack_counter.errors import WeightsError

GRAPH = "graph"  # name of the tensor that holds the bytes of the graph


class NetworkSession:
    """A graph with its weights, ready to run."""

    def __init__(self, path: Path, tensors: Mapping[str, np.ndarray]):
        """Loads a network.

        Args:
            path: its file, named where it cannot be loaded.
            tensors: of the file: the graph, and the weights by their names in it, in half or
                single precision.

        Raises:
            WeightsError: there is no graph, or weights of it are missing.
        """
        import onnxruntime  # loaded where a network runs, and nowhere else

        if GRAPH not in tensors:
            raise WeightsError(f"{path} has no graph; expected a file that training has written "
                               "with one")
        options = onnxruntime.SessionOptions()
        threads = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
        options.intra_op_num_threads = int(threads) if threads.isdecimal() else 0  # 0: all cores
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        weights = {name: onnxruntime.OrtValue.ortvalue_from_numpy(
                       values.astype(np.float32, order="C"))  # it takes no other
                   for name, values in tensors.items() if name != GRAPH}
        options.add_external_initializers(list(weights), list(weights.values()))
        try:
            self._session = onnxruntime.InferenceSession(
                tensors[GRAPH].tobytes(), options, providers=["CPUExecutionProvider"])
        except Exception as error:  # its own, which share no other base
            raise WeightsError(f"{path} does not hold the network it names: "
                               f"{' '.join(str(error).split())[:200]}") from error
        self._inputs = [value.name for value in self._session.get_inputs()]

    def __call__(self, **inputs: np.ndarray) -> list[np.ndarray]:
        """Returns the outputs, float32, of inputs by name, float32 with the batch first.

        Inputs that the graph does not have are left out: it was exported without them.
        """
        return self._session.run(None, {name: inputs[name] for name in self._inputs})
