"""gamma by the network: an ensemble over tiles, its spread, and whether it knows such stacks."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import torch
from torch import nn

from stack_counter.errors import WeightsError
from stack_counter.occupancy.baselines import OccupancyEstimator
from stack_counter.occupancy.gamma_net import GammaNet, load_members, read_tuning, tuned_name
from stack_counter.occupancy.maps import (
    PIXELS_PER_LENGTH,
    StackMaps,
    key_view_maps,
    network_channels,
    picture_maps,
    stack_maps,
    surface_features,
    tiles,
)
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

if TYPE_CHECKING:
    from stack_counter.occupancy.depth_anything import MonocularDepth

SHIPPED = "gamma.safetensors"
_LEAST_PARTS = 12  # of the training piles
_SHALLOW = 0.35  # mean height in l below which a stack is a scattering of parts
# Part sizes that the container should be wide: training's are 4 or more; the size seen is a
# tenth off.
_LEAST_WIDTH = 3.5
_LARGEST_GAMMA = 0.98
_DOUBTED, _SINGLE_VIEW = 1.5, 2.0  # times the spread, where there are reasons; of a key view alone
_TENSORS = ("scores", "scores_one_side", "centers", "middle", "whiten", "reach")


class NetworkEstimator:
    """The gamma-network with its calibration."""

    def __init__(self, path: Path | None, without_depth: OccupancyEstimator,
                 encoder_folder: Path | None = None, depth_folder: Path | None = None):
        """Loads it.

        Args:
            path: weights; None is the file shipped with the package.
            encoder_folder: of DINOv2, for weights trained upon it.
            without_depth: answers where there is nothing to read.
            depth_folder: of Depth Anything, for key views in colour only. What it gives has no
                scale: only networks upon DINOv2 can read it, as in the paper.

        Raises:
            WeightsError: missing, not safetensors, of another format or not whole; or Depth
                Anything beside a network of our own.
        """
        shipped = Path(str(resources.files("stack_counter") / "weights" / SHIPPED))
        self._members, facts, more = load_members(path or shipped, encoder_folder)
        if set(more) != set(_TENSORS):
            raise WeightsError(f"{path or shipped} has calibration {sorted(more)}; expected "
                               f"{sorted(_TENSORS)}")
        self._scores, self._one_side, self._centers, *known = (
            more[name].double().numpy() for name in _TENSORS)
        self._known = TrainingDomain(*known)
        self.name = f"network {facts.get('version', 'unnamed')}"
        self._without_depth = without_depth
        self._monocular: MonocularDepth | None = None
        if depth_folder is not None:
            if isinstance(self._members[0], GammaNet):
                raise WeightsError(f"depth_weights {depth_folder} beside a network that reads "
                                   "heights in part lengths; expected one upon DINOv2")
            from stack_counter.occupancy.depth_anything import MonocularDepth  # needs transformers

            self._monocular = MonocularDepth(depth_folder)

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """gamma of a stack whose parts have `unit_volume` (m3) each.

        Raises:
            ScanError: the surface cannot be read at that size of parts.
        """
        maps = self._maps(volume, unit_volume)
        if maps is None:
            return self._without_depth.estimate(volume, unit_volume)
        from_key_view = volume.top is None
        if not maps.height.any():
            return OccupancyEstimate(0.5, 0.25, self._scores, self.name)
        scores = self._one_side if volume.one_side else self._scores
        log_gamma, spread, form = predict(self._members, maps)
        gamma = min(float(np.exp(log_gamma + self._centers[int(volume.one_side)])), _LARGEST_GAMMA)
        reasons, wider = doubt_reasons(
            maps, gamma * volume.stack_volume / unit_volume, float(np.exp(form[0])),
            volume.container.kind not in ("none", "hull"), self._known)
        if from_key_view:
            reasons, wider = [*reasons, Reason.SINGLE_VIEW], max(wider, _SINGLE_VIEW)
        return OccupancyEstimate(gamma, gamma * spread * wider, scores, self.name,
                                 tuple(reasons))

    def hidden(self, volume: StackVolume, unit_volume: float) -> np.ndarray:
        """(members, h): see the function of that name.

        Raises:
            ScanError: as `estimate`.
            WeightsError: as that function.
        """
        return hidden(self._members, stack_maps(volume, unit_volume))

    def tuned(self, path: Path) -> NetworkEstimator:
        """The same with last layers that `part.tune` has adapted to one part.

        Raises:
            WeightsError: not such a file, or of another network.
        """
        weight, bias, of = read_tuning(path)
        if of != self.name or weight.shape[0] != len(self._members):
            raise WeightsError(f"{path} is tuned from '{of}'; expected '{self.name}'")
        other = copy.copy(self)
        other.name = tuned_name(self.name, weight, bias)
        other._members = [copy.deepcopy(net) for net in self._members]
        with torch.no_grad():
            for net, change in zip(other._members, weight):
                last = net.head[-1]
                assert isinstance(last, nn.Linear)  # of GammaNet; others have no `hidden`
                last.weight[0] += torch.from_numpy(change).float()
                last.bias[0] += bias
        return other

    def _maps(self, volume: StackVolume, unit_volume: float) -> StackMaps | None:
        """From the best that there is to read; None if there is nothing."""
        view = volume.key_view
        if volume.top is not None:
            return stack_maps(volume, unit_volume)
        if view is not None and view.depth is not None:
            return key_view_maps(volume, unit_volume)
        if view is not None and view.color is not None and self._monocular is not None:
            return picture_maps(view, self._monocular.nearness(view.color))
        return None


@dataclass(frozen=True)
class TrainingDomain:
    """What surfaces were learnt from: the middle of their features (6,), what whitens them (6, 6),
    and the distance that 99 of 100 of them keep from it (1,).
    """

    middle: np.ndarray
    whiten: np.ndarray
    reach: np.ndarray

    def strangeness(self, maps: StackMaps) -> float:
        """Mahalanobis distance of a surface's features from the middle, over that reach."""
        away = (surface_features(maps) - self.middle) @ self.whiten
        return float(np.linalg.norm(away) / self.reach[0])


def _tiled(maps: StackMaps) -> tuple[torch.Tensor, np.ndarray]:
    """Tiles that hold something, (n, CHANNELS, TILE, TILE), and their weights (n,)."""
    pieces = [piece for piece in tiles(maps) if piece.height.any()]
    weights = np.array([piece.height.sum() for piece in pieces], float)
    return (torch.from_numpy(np.stack([network_channels(piece) for piece in pieces])),
            weights / weights.sum())


def predict(members: Sequence[nn.Module], maps: StackMaps) -> tuple[float, float, np.ndarray]:
    """Log gamma, the relative standard deviation of gamma, and the part's form (see
    `GammaNet.forward`): tiles weighted by what stands in them, members alike.
    """
    x, weights = _tiled(maps)
    with torch.inference_mode():
        out = [net(x) for net in members]
    mean = np.mean([o[0].numpy() for o in out], axis=0)  # (tiles,)
    scale = np.mean([np.exp(o[1].numpy()) for o in out], axis=0)
    form = np.mean([o[2].numpy() for o in out], axis=0)
    return (float(np.log(weights @ np.exp(mean))), float(np.sqrt(2) * weights @ scale),
            weights @ form)


def hidden(members: Sequence[nn.Module], maps: StackMaps) -> np.ndarray:
    """(members, h) float64: what the last layer of each reads, tiles weighted as in `predict`.

    Raises:
        WeightsError: networks upon DINOv2, which have no such layer.
    """
    x, weights = _tiled(maps)
    out = []
    for net in members:
        if not isinstance(net, GammaNet):
            raise WeightsError("the network is upon DINOv2; expected one of our own to tune")
        out.append(weights @ _last_input(net, x))
    return np.array(out, float)


def _last_input(net: GammaNet, x: torch.Tensor) -> np.ndarray:
    """(n, h) that the last layer reads of (n, CHANNELS, TILE, TILE)."""
    read: list[torch.Tensor] = []
    hook = net.head[-1].register_forward_hook(lambda _, args, __: read.append(args[0]))
    try:
        with torch.inference_mode():
            net(x)
    finally:
        hook.remove()
    return read[0].numpy()


def doubt_reasons(maps: StackMaps, parts: float, size: float, walled: bool, known: TrainingDomain
           ) -> tuple[list[Reason], float]:
    """Reasons to doubt an estimate, and how much wider they make its spread.

    Args:
        maps: the surface.
        parts: how many there seem to be.
        size: of a part, as the network sees it, in l.
        walled: in a container.
        known: what was learnt from.
    """
    far, reasons = known.strangeness(maps), list[Reason]()
    if maps.height[maps.valid].mean() < _SHALLOW:
        reasons.append(Reason.SHALLOW_STACK)
    if parts < _LEAST_PARTS:
        reasons.append(Reason.FEW_PARTS)
    if walled and min(maps.valid.shape) / PIXELS_PER_LENGTH < _LEAST_WIDTH * size:
        reasons.append(Reason.LARGE_PART)
    if far > 1:
        reasons.append(Reason.UNLIKE_TRAINING)
    return reasons, max(far, _DOUBTED if reasons else 1.0)
