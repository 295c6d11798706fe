"""gamma: the `OccupancyEstimator` protocol and the paper's own baselines (section 4.3)."""

from __future__ import annotations

from collections.abc import Callable
from importlib import resources
from pathlib import Path
from typing import Protocol

import numpy as np
from safetensors import SafetensorError, safe_open

from stack_counter.config import CounterConfig
from stack_counter.errors import ConfigError, WeightsError
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

_SHIPPED = "baselines.safetensors"
FORMAT = "stack_counter baselines 1"
_TENSORS = {"line": (2,), "prior": (2,), "ratios_corrected": None, "ratios_extrapolated": None,
            "ratios_prior": None}


class OccupancyEstimator(Protocol):
    """Says which fraction of a stack's volume the parts fill."""

    name: str

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """gamma of a stack whose parts have `unit_volume` (m3) each."""
        ...


def normalized_height(volume: StackVolume) -> float | None:
    """Mean height of the visible surface above the inner one, over the highest.

    Source: paper, section 4.3, the mean of d_i / d_max over the top view's pixels. Here d is the
    height of the top-surface map above the container's inner surface. None without such a map,
    or for an empty one.
    """
    if volume.top is None or volume.inner is None:
        return None
    heights = (volume.top.heights - volume.inner.heights)[np.isfinite(volume.top.heights)]
    if not len(heights):
        return None
    highest = float(np.percentile(heights, 99.5))  # the maximum itself is a single cell's noise
    if highest <= 0:
        return None
    return float(np.clip(heights / highest, 0, 1).mean())


class Baselines:
    """The fitted numbers behind all three baselines."""

    def __init__(self, path: Path | None = None):
        """Loads them; None is the file shipped with the package.

        Raises:
            WeightsError: missing, not safetensors, or of another format.
        """
        shipped = Path(str(resources.files("stack_counter") / "weights" / _SHIPPED))
        self.path = path or shipped
        if not self.path.is_file():
            raise WeightsError(f"no weights file {self.path}; expected a safetensors file")
        try:
            with safe_open(self.path, framework="numpy") as file:
                kind = (file.metadata() or {}).get("format")
                tensors = {name: file.get_tensor(name).astype(float) for name in file.keys()}
        except (SafetensorError, OSError) as error:
            raise WeightsError(f"{self.path} is not a whole safetensors file: {error}") from error
        if kind != FORMAT or set(tensors) != set(_TENSORS):
            raise WeightsError(f"{self.path} is '{kind}'; expected '{FORMAT}'")
        for name, shape in _TENSORS.items():
            if not np.isfinite(tensors[name]).all() or shape not in (None, tensors[name].shape):
                raise WeightsError(f"{self.path}: {name} is {tensors[name]}; expected finite "
                                   f"numbers of shape {shape}")
        self.line, self.prior = tensors["line"], tensors["prior"]
        self.ratios = {name.removeprefix("ratios_"): value for name, value in tensors.items()
                       if name.startswith("ratios_")}


class Prior:
    """The mean of the training piles, whatever the picture (the paper's mean estimator)."""

    name = "prior (baseline)"

    def __init__(self, baselines: Baselines):
        self._fit = baselines

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """The training mean and spread; reason `no_depth` if there was no depth to read."""
        reasons = (Reason.NO_DEPTH,) if volume.top is None else ()
        return _with_spread(float(self._fit.prior[0]), self._fit.ratios["prior"], self.name,
                            reasons)


class DepthExtrapolated:
    """gamma = mean of d / d_max over the top view."""

    name = "depth_extrapolated (baseline)"

    def __init__(self, baselines: Baselines):
        self._fit, self._prior = baselines, Prior(baselines)

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """See `normalized_height`; the prior where there is no map."""
        gamma = normalized_height(volume)
        if gamma is None:
            return self._prior.estimate(volume, unit_volume)
        return _with_spread(gamma, self._fit.ratios["extrapolated"], self.name)


class DepthCorrected:
    """gamma = a * mean of d / d_max + b, fitted on simulated piles."""

    name = "depth_corrected (baseline)"

    def __init__(self, baselines: Baselines):
        self._fit, self._prior = baselines, Prior(baselines)

    def estimate(self, volume: StackVolume, unit_volume: float) -> OccupancyEstimate:
        """The fitted line at `normalized_height`; the prior where there is no map."""
        height = normalized_height(volume)
        if height is None:
            return self._prior.estimate(volume, unit_volume)
        gamma = float(np.clip(self._fit.line[0] * height + self._fit.line[1], 0.02, 0.95))
        return _with_spread(gamma, self._fit.ratios["corrected"], self.name)


def _with_spread(gamma: float, ratios: np.ndarray, name: str, reasons: tuple[Reason, ...] = ()
                 ) -> OccupancyEstimate:
    """An estimate whose errors are all alike: `ratios` of true over estimated gamma."""
    logs = np.log(np.maximum(ratios, 1e-6))
    std = max(float(np.std(logs)), 1e-6)
    return OccupancyEstimate(gamma, gamma * std, logs / std, name, reasons)


def make_estimator(config: CounterConfig) -> OccupancyEstimator:
    """The estimator that the settings name.

    Raises:
        ConfigError: unknown name.
        WeightsError: its weights cannot be loaded.
    """
    kinds: dict[str, Callable[[Baselines], OccupancyEstimator]] = {
        "depth_corrected": DepthCorrected, "depth_extrapolated": DepthExtrapolated,
        "prior": Prior}
    weights, encoder, depth = (Path(text) if text else None for text in (
        config.weights, config.encoder_weights, config.depth_weights))
    if config.estimator == "network":
        from stack_counter.occupancy.network import (
            NetworkEstimator,  # brings in torch, which takes seconds
        )

        return NetworkEstimator(weights, Prior(Baselines()), encoder, depth)
    if config.estimator == "direct":
        from stack_counter.occupancy.direct_count import DirectCount

        return DirectCount(weights, Prior(Baselines()))
    if config.estimator not in kinds:
        raise ConfigError(f"unknown estimator '{config.estimator}'; expected one of "
                          f"{sorted([*kinds, 'direct', 'network'])}")
    return kinds[config.estimator](Baselines(weights))
