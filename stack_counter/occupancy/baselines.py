# SPDX-License-Identifier: Apache-2.0
"""The paper's baselines for gamma (section 4.3), fitted on simulated piles."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from typing_extensions import override

from stack_counter.errors import WeightsError
from stack_counter.files import read_weights, shipped_weights
from stack_counter.occupancy.estimator import OccupancyEstimator
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

FORMAT = "stack_counter baselines 1"
_SHIPPED = "baselines.safetensors"
# Tensors of the file and their shapes; None: of any length.
_TENSORS: dict[str, tuple[int, ...] | None] = {
    "line": (2,), "prior": (2,), "ratios_corrected": None, "ratios_extrapolated": None,
    "ratios_prior": None}
_EPSILON = 1e-6


@dataclass(frozen=True)
class BaselineSettings:
    """How the baselines read a surface; all chosen.

    Attributes:
        highest_percentile: percentile of the heights that counts as the highest: the maximum
            itself is the noise of a single cell.
        gamma_range: smallest and largest gamma that the fitted line may give.
    """

    highest_percentile: float = 99.5
    gamma_range: tuple[float, float] = (0.02, 0.95)


SETTINGS = BaselineSettings()


class Baselines:
    """The fitted numbers behind all three baselines.

    Attributes:
        path: the file that they come from.
        line: (2,) slope and offset of gamma over the normalised height.
        prior: (2,) mean and standard deviation of gamma over the training piles.
        ratios: for each baseline quantiles of true over estimated gamma on families left out.
    """

    def __init__(self, path: Path | None = None):
        """Reads a file; None is the one shipped with the package.

        Raises:
            WeightsError: the file is missing, not safetensors, or of another format.
        """
        self.path = path or shipped_weights(_SHIPPED)
        tensors = {name: tensor.astype(float)
                   for name, tensor in read_weights(self.path, FORMAT).tensors.items()}
        if set(tensors) != set(_TENSORS):
            raise WeightsError(f"{self.path} holds {sorted(tensors)}; expected {sorted(_TENSORS)}")
        for name, shape in _TENSORS.items():
            if shape not in (None, tensors[name].shape):
                raise WeightsError(f"{self.path}: {name} is {tensors[name]}; expected numbers of "
                                   f"shape {shape}")
        self.line, self.prior = tensors["line"], tensors["prior"]
        self.ratios = {name.removeprefix("ratios_"): values for name, values in tensors.items()
                       if name.startswith("ratios_")}


class Prior(OccupancyEstimator):
    """The mean of the training piles, whatever the surface (the paper's mean estimator)."""

    name = "prior (baseline)"

    def __init__(self, baselines: Baselines):
        """Takes its mean and errors from `baselines`."""
        self._baselines = baselines

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        reasons = (Reason.NO_DEPTH,) if volume.top is None else ()
        return _estimate_with_errors(float(self._baselines.prior[0]),
                                     self._baselines.ratios["prior"], self.name, reasons)


class DepthExtrapolated(OccupancyEstimator):
    """gamma is the normalised height; without a top-surface map it is the prior."""

    name = "depth_extrapolated (baseline)"

    def __init__(self, baselines: Baselines):
        """Takes its errors from `baselines`."""
        self._baselines, self._prior = baselines, Prior(baselines)

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        height = normalized_height(volume)
        if height is None:
            return self._prior.estimate(volume, unit_volume)
        return _estimate_with_errors(height, self._baselines.ratios["extrapolated"], self.name)


class DepthCorrected(OccupancyEstimator):
    """gamma is a line fitted over the normalised height; without a map it is the prior."""

    name = "depth_corrected (baseline)"

    def __init__(self, baselines: Baselines):
        """Takes its line and errors from `baselines`."""
        self._baselines, self._prior = baselines, Prior(baselines)

    @override
    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        height = normalized_height(volume)
        if height is None:
            return self._prior.estimate(volume, unit_volume)
        slope, offset = self._baselines.line
        gamma = float(np.clip(slope * height + offset, *SETTINGS.gamma_range))
        return _estimate_with_errors(gamma, self._baselines.ratios["corrected"], self.name)


def normalized_height(volume: StackVolume) -> float | None:
    """Mean height of the visible surface above the inner one, over the highest; 0 to 1.

    Source: paper, section 4.3, the mean of d_i / d_max over the top view's pixels. Here d is the
    height of the top-surface map above the container's inner surface.

    Returns:
        None where there is no such map or nothing stands in it.
    """
    if volume.top is None or volume.inner is None:
        return None
    heights = (volume.top.heights - volume.inner.heights)[np.isfinite(volume.top.heights)]
    if not len(heights):
        return None
    highest = float(np.percentile(heights, SETTINGS.highest_percentile))
    if highest <= 0:
        return None
    return float(np.clip(heights / highest, 0, 1).mean())


def _estimate_with_errors(gamma: float, ratios: np.ndarray, name: str,
                          reasons: tuple[Reason, ...] = ()) -> OccupancyEstimate:
    """Makes an estimate whose relative error is the same for every stack.

    Args:
        gamma: as estimated.
        ratios: (n,) true over estimated gamma, on families left out of the fit.
        name: of the estimator.
        reasons: what qualifies the estimate.
    """
    log_ratios = np.log(np.maximum(ratios, _EPSILON))
    std = max(float(np.std(log_ratios)), _EPSILON)
    return OccupancyEstimate(gamma, gamma * std, log_ratios / std, name, reasons)
