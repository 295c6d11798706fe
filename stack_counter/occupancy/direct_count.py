# SPDX-License-Identifier: Apache-2.0
"""A count straight from the picture, without v or V: what the paper tried first and gave up.

Source: paper, section 4.2, the rows "CNN" and "ViT+H". A baseline for comparison.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import torch
from typing_extensions import override

from stack_counter.errors import WeightsError
from stack_counter.files import shipped_weights
from stack_counter.occupancy.checkpoint import load_members
from stack_counter.occupancy.estimator import OccupancyEstimator
from stack_counter.occupancy.maps import TILE, StackMaps, crop_tile, network_channels, stack_maps
from stack_counter.types import OccupancyEstimate, StackVolume

TYPICAL_COUNT = 150.0  # parts: the network gives the log of the count over this
_SHIPPED = "direct.safetensors"
_STACK_SHARE = 0.8  # share of the tile that the stack's longer side takes


@dataclass(frozen=True)
class CountPrediction:
    """What the network reads from a picture.

    Attributes:
        log_count: log of the number of parts.
        std: standard deviation of `log_count`.
    """

    log_count: float
    std: float


class DirectCount(OccupancyEstimator):
    """The network predicts the count; gamma is what V and v make of it."""

    name = "direct count (baseline)"

    def __init__(self, path: Path | None, without_depth: OccupancyEstimator):
        """Loads the network.

        Args:
            path: weights; None is the file shipped with the package.
            without_depth: estimator asked where there is no surface.

        Raises:
            WeightsError: the file is missing, not safetensors, not whole, or of a network that
                has not learnt to count.
        """
        path = path or shipped_weights(_SHIPPED)
        checkpoint = load_members(path)
        if checkpoint.facts.get("learnt") != "count" or "scores" not in checkpoint.calibration:
            raise WeightsError(f"{path} has learnt '{checkpoint.facts.get('learnt', 'gamma')}'; "
                               "expected 'count'")
        self._net, self._scores = checkpoint.members[0], checkpoint.calibration["scores"]
        self._without_depth = without_depth

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        if volume.top is None or not volume.stack_volume > 0:
            return self._without_depth.estimate(volume, unit_volume)
        prediction = predict_count(self._net, fit_to_tile(stack_maps(volume, unit_volume)))
        gamma = float(np.exp(prediction.log_count)) * unit_volume / volume.stack_volume
        return OccupancyEstimate(gamma, gamma * prediction.std, self._scores, self.name)


def fit_to_tile(maps: StackMaps) -> StackMaps:
    """Scales the whole stack into the middle of one tile, its heights alike.

    The tile shows no part size: it is the same for small parts and for large ones.
    """
    # Resample to the tile.
    scale = _STACK_SHARE * TILE / max(maps.valid.shape)
    cols, rows = (max(round(n * scale), 1) for n in maps.valid.shape[::-1])
    interpolation = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    top, height, valid_share, wall = (
        cv2.resize(a.astype(np.float32), (cols, rows), interpolation=interpolation)
        for a in (maps.top, maps.height, maps.valid, maps.wall))
    # Scale the heights alike and cut the tile around the middle.
    valid = valid_share > 0.5
    top, height, wall = (np.where(valid, a * scale, 0).astype(np.float32)
                         for a in (top, height, wall))
    return crop_tile(StackMaps(top, height, valid, wall), (rows - TILE) // 2, (cols - TILE) // 2)


def predict_count(net: torch.nn.Module, tile: StackMaps) -> CountPrediction:
    """Predicts the count of a stack that `fit_to_tile` has framed."""
    with torch.inference_mode():
        out = net(torch.from_numpy(network_channels(tile))[None])
    return CountPrediction(float(out.log_gamma) + float(np.log(TYPICAL_COUNT)),
                           float(np.sqrt(2) * torch.exp(out.log_scale)))
