# SPDX-License-Identifier: Apache-2.0
"""A `StackVolume` becomes gamma: the network, and the paper's baselines."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from stack_counter.config import CounterConfig
from stack_counter.errors import ConfigError
from stack_counter.occupancy.baselines import Baselines, DepthCorrected, DepthExtrapolated, Prior
from stack_counter.occupancy.estimator import OccupancyEstimator
from stack_counter.occupancy.network import NetworkEstimator

__all__ = ["OccupancyEstimator", "make_estimator"]

_BASELINES: dict[str, Callable[[Baselines], OccupancyEstimator]] = {
    "depth_corrected": DepthCorrected, "depth_extrapolated": DepthExtrapolated, "prior": Prior}


def make_estimator(config: CounterConfig) -> OccupancyEstimator:
    """Makes the estimator that the settings name.

    Raises:
        ConfigError: no estimator has that name.
        WeightsError: its weights cannot be loaded.
    """
    weights, encoder_folder, depth_folder = (Path(text) if text else None for text in (
        config.weights, config.encoder_weights, config.depth_weights))
    if config.estimator == "network":
        return NetworkEstimator(weights, Prior(Baselines()), encoder_folder, depth_folder)
    if config.estimator == "direct":
        from stack_counter.occupancy.direct_count import DirectCount  # brings in torch

        return DirectCount(weights, Prior(Baselines()))
    if config.estimator not in _BASELINES:
        raise ConfigError(f"unknown estimator '{config.estimator}'; expected one of "
                          f"{sorted([*_BASELINES, 'direct', 'network'])}")
    return _BASELINES[config.estimator](Baselines(weights))
