# SPDX-License-Identifier: Apache-2.0
"""An ensemble of networks as the estimator asks it, and as ONNX Runtime runs it, without torch."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np


class EnsembleOutput(NamedTuple):
    """What m networks give for b tiles; all float32.

    Attributes:
        log_gamma: (m, b) log of the occupancy ratio.
        log_scale: (m, b) log of the scale of its Laplace error.
        shape_logs: (m, b, SHAPE_OUTPUTS) logs of part size, convexity and surface, part lengths.
        last_layer_input: (m, b, h) what the last layer reads; h is 0 for networks upon DINOv2.
    """

    log_gamma: np.ndarray
    log_scale: np.ndarray
    shape_logs: np.ndarray
    last_layer_input: np.ndarray


# Takes (b, CHANNELS, TILE, TILE) float32 inputs of `maps.network_channels`.
Ensemble = Callable[[np.ndarray], EnsembleOutput]


class OnnxEnsemble:
    """Runs the graph of an ensemble by ONNX Runtime."""

    def __init__(self, graph: bytes, tensors: Mapping[str, np.ndarray]):
        """Loads graph and weights.

        Args:
            graph: as `onnx_export.export_graph` gives it.
            tensors: weights by their names in the graph, in half or single precision.

        Raises:
            Exception: ONNX Runtime's own; the graph is none, or lacks weights.
        """
        import onnxruntime  # loaded where a network runs, and nowhere else

        options = onnxruntime.SessionOptions()
        options.intra_op_num_threads = int(os.environ.get("OMP_NUM_THREADS", 0))  # 0: all cores
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        # Weights are kept here until the session has taken them over.
        weights = {name: onnxruntime.OrtValue.ortvalue_from_numpy(values.astype(np.float32))
                   for name, values in tensors.items()}
        options.add_external_initializers(list(weights), list(weights.values()))
        self._session = onnxruntime.InferenceSession(graph, options,
                                                     providers=["CPUExecutionProvider"])

    def __call__(self, tiles: np.ndarray) -> EnsembleOutput:
        """Estimates tiles."""
        return EnsembleOutput(*self._session.run(list(EnsembleOutput._fields), {"tiles": tiles}))
