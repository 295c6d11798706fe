# SPDX-License-Identifier: Apache-2.0
"""An ensemble of networks as the estimator asks it, and as ONNX Runtime runs it."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from stack_counter.inference import NetworkSession


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


# Takes (b, CHANNELS, TILE, TILE) float32 inputs of `maps.network_channels`, and what holds for all
# of them: (KNOWN_VALUES,) of `known_form.known_values`, (RESOLUTION_VALUES,) of
# `resolution.resolution_values`. Networks that cannot read these ignore them.
Ensemble = Callable[[np.ndarray, np.ndarray, np.ndarray], EnsembleOutput]


class OnnxEnsemble:
    """Networks of one file, run by ONNX Runtime."""

    def __init__(self, session: NetworkSession):
        """`session`: of a graph that `train.onnx_export.export_ensemble` has written."""
        self._session = session

    def __call__(self, tiles: np.ndarray, known: np.ndarray, resolution: np.ndarray
                 ) -> EnsembleOutput:
        """Estimates tiles."""
        known, resolution = (np.tile(numbers, (len(tiles), 1)) for numbers in (known, resolution))
        return EnsembleOutput(*self._session(tiles=tiles, known=known, resolution=resolution))
