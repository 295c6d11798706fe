# SPDX-License-Identifier: Apache-2.0
"""gamma of a part of which more is known than v: simulated piles of it, or counted bins."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from stack_counter.files import shipped_weights
from stack_counter.occupancy import OccupancyEstimator
from stack_counter.occupancy.network import NetworkEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.parts.gamma_model import Reading, fill_size
from stack_counter.parts.part_models import PartModels, read_models
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

SHIPPED = "parts.json"


@dataclass(frozen=True)
class InformedGammaSettings:
    """When the estimator disagrees with what is known of a part.

    Attributes:
        max_z_score: standard deviations by which the estimator may be off what is known; above,
            the spread grows with it. Chosen.
        max_gamma: largest gamma that is given; chosen.
    """

    max_z_score: float = 3.0
    max_gamma: float = 0.98


SETTINGS = InformedGammaSettings()


@cache
def models_of_other_parts() -> PartModels:
    """What scans of one part have in common, from parts that the estimator had not seen."""
    return read_models(shipped_weights(SHIPPED))


def tuned_estimator(estimator: OccupancyEstimator, part: Part) -> OccupancyEstimator:
    """The estimator, or the network with the last layers that were tuned to a part.

    Raises:
        WeightsError: the tuned layers cannot be read, or are another network's.
    """
    if part.tuned is None:
        return estimator
    if not isinstance(estimator, NetworkEstimator):
        return estimator
    return _tuned_network(estimator, part.tuned,
                          part.tuned.stat().st_mtime_ns if part.tuned.exists() else 0)


@lru_cache(maxsize=8)
def _tuned_network(network: NetworkEstimator, path: Path, changed_ns: int) -> NetworkEstimator:
    return network.tuned(path)


def estimate_occupancy(volume: StackVolume, part: Part, estimator: OccupancyEstimator
                       ) -> OccupancyEstimate:
    """Estimates gamma by the estimator, joined with what is known of the part.

    It may add the reasons `part_unused`, `calibrated_elsewhere`, `estimator_unheard`,
    `fill_unlike_piles` and `part_disagrees`.

    Raises:
        ScanError: the estimator can say no gamma of this scan.
        PartError: the part's models cannot be read.
        WeightsError: the part's tuned layers cannot be read.
    """
    estimate = tuned_estimator(estimator, part).estimate(volume, part.unit_volume)
    # Choose what is known: models of the part's own piles, else what other parts tell of counted
    # scans; nothing where V is another from scan to scan.
    history = scans_of_same_rig(part.counted, volume)
    reasons = estimate.reasons + ((Reason.PART_UNUSED,) if part.overridden else ())
    if part.counted and not history:
        reasons += (Reason.CALIBRATED_ELSEWHERE,)
    models = part.models or (models_of_other_parts() if history else None)
    if models is not None and (volume.top is None or volume.container.kind in ("none", "hull")):
        models, reasons = None, (*reasons, Reason.PART_UNUSED)
    if models is None or not volume.stack_volume > 0:
        spread = np.hypot(estimate.gamma_std / estimate.gamma, part.relative_std)
        return replace(estimate, gamma_std=estimate.gamma * float(spread), reasons=reasons)
    # Join it with the estimate, if the models know this estimator.
    model = models.one_side if volume.one_side else models.arc
    log_gamma = np.log(estimate.gamma) if models.estimator == estimate.estimator else np.nan
    if np.isnan(log_gamma):
        reasons += (Reason.ESTIMATOR_UNHEARD,)
    scan = Reading(*fill_size(volume, part.unit_volume), float(log_gamma))
    posterior = model.posterior(scan, [s.reading(models.estimator) for s in history],
                                part.relative_std)
    # Widen the spread where the estimate is far off what is known.
    if not model.covers(scan):
        reasons += (Reason.FILL_UNLIKE_PILES,)
    widening = max(abs(posterior.estimator_z_score) / SETTINGS.max_z_score, 1.0)
    if widening > 1:
        reasons += (Reason.PART_DISAGREES,)
    gamma = min(float(np.exp(posterior.mean)), SETTINGS.max_gamma)
    return OccupancyEstimate(gamma, gamma * posterior.std * widening, model.scores,
                             estimate.estimator, reasons, posterior.shares, len(history))
