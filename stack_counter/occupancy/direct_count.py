"""A count straight from the picture, without v or V: what the paper tried first and gave up.

Source: paper, section 4.2, the rows "CNN" and "ViT+H". A baseline for comparison.
"""

from __future__ import annotations

from importlib import resources
from pathlib import Path

import cv2
import numpy as np
import torch

from stack_counter.errors import WeightsError
from stack_counter.occupancy.baselines import OccupancyEstimator
from stack_counter.occupancy.gamma_net import load_members
from stack_counter.occupancy.maps import TILE, StackMaps, crop, network_channels, stack_maps
from stack_counter.types import OccupancyEstimate, StackVolume

SHIPPED = "direct.safetensors"
TYPICAL = 150.0  # parts: the network says the log of the count over this
_SPAN = 0.8  # of the tile, that the stack's longer side takes


class DirectCount:
    """The network says the count; gamma is what V and v make of it."""

    name = "direct count (baseline)"

    def __init__(self, path: Path | None, without_depth: OccupancyEstimator):
        """Loads it; None is the file shipped with the package; `without_depth` answers where
        there is no surface.

        Raises:
            WeightsError: as `load_members`, or weights of another network.
        """
        shipped = Path(str(resources.files("stack_counter") / "weights" / SHIPPED))
        members, facts, more = load_members(path or shipped)
        if facts.get("learnt") != "count" or "scores" not in more:
            raise WeightsError(f"{path or shipped} has learnt '{facts.get('learnt', 'gamma')}'; "
                               "expected 'count'")
        self._net, self._scores = members[0], more["scores"].numpy().astype(float)
        self._without_depth = without_depth

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """gamma such that gamma * V / v is the count that the picture looks like."""
        if volume.top is None or not volume.stack_volume > 0:
            return self._without_depth.estimate(volume, unit_volume)
        log_count, spread = predict_log_count(
            self._net, fit_to_tile(stack_maps(volume, unit_volume))
        )
        gamma = float(np.exp(log_count)) * unit_volume / volume.stack_volume
        return OccupancyEstimate(gamma, gamma * spread, self._scores, self.name, ())


def fit_to_tile(maps: StackMaps) -> StackMaps:
    """The whole stack in the middle of one tile, whatever its parts' size; heights are scaled
    alike.
    """
    scale = _SPAN * TILE / max(maps.valid.shape)
    cols, rows = (max(round(n * scale), 1) for n in maps.valid.shape[::-1])
    how = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    top, height, valid, wall = (
        cv2.resize(a.astype(np.float32), (cols, rows), interpolation=how)
        for a in (maps.top, maps.height, maps.valid, maps.wall))
    inside = valid > 0.5
    top, height, wall = (np.where(inside, a * scale, 0).astype(np.float32)
                         for a in (top, height, wall))
    return crop(StackMaps(top, height, inside, wall), (rows - TILE) // 2, (cols - TILE) // 2)


def predict_log_count(net: torch.nn.Module, tile: StackMaps) -> tuple[float, float]:
    """Log of the count, and its standard deviation, from a framed stack."""
    with torch.inference_mode():
        mean, scale, _ = net(torch.from_numpy(network_channels(tile))[None])
    return float(mean) + float(np.log(TYPICAL)), float(np.sqrt(2) * torch.exp(scale))
