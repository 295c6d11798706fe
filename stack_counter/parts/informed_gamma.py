"""gamma of a part of which more is known than v: simulated piles of it, or counted bins."""

from __future__ import annotations

from dataclasses import replace
from functools import cache, lru_cache
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stack_counter.occupancy.baselines import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import scans_of_same_rig
from stack_counter.parts.gamma_model import PartModels, Reading, read_models, size_of
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

if TYPE_CHECKING:
    from stack_counter.occupancy.network import NetworkEstimator

SHIPPED = "parts.json"
_DISAGREE = 3.0  # standard deviations
_LARGEST_GAMMA = 0.98


@cache
def other_parts() -> PartModels:
    """What scans of one part have in common, from parts that the estimator had not seen."""
    return read_models(Path(str(resources.files("stack_counter") / "weights" / SHIPPED)))


def tuned_estimator(estimator: OccupancyEstimator, part: Part) -> OccupancyEstimator:
    """The estimator, or the network as it is tuned to a part.

    Raises:
        WeightsError: the tuned layers cannot be read, or are another network's.
    """
    if part.tuned is None:
        return estimator
    from stack_counter.occupancy.network import (
        NetworkEstimator,  # brings in torch, which takes seconds
    )

    if not isinstance(estimator, NetworkEstimator):
        return estimator
    return _tuned(estimator, part.tuned,
                  part.tuned.stat().st_mtime_ns if part.tuned.exists() else 0)


@lru_cache(maxsize=8)
def _tuned(network: NetworkEstimator, path: Path, changed_ns: int) -> NetworkEstimator:
    return network.tuned(path)


def estimate_occupancy(volume: StackVolume, part: Part, estimator: OccupancyEstimator
                  ) -> OccupancyEstimate:
    """gamma from the estimator, joined with what is known of the part.

    Reasons it may add: `part_disagrees`: the estimator is more than three standard deviations off
    what is known (another part in the bin, ordered packing, foreign objects); `fill_unlike_piles`:
    lower or narrower than the piles; `part_unused`: what is known cannot be used, without depth or
    container, or because another v was given; `calibrated_elsewhere`: no counted scan is of this
    rig; `estimator_unheard`: the piles were read by another estimator, so this one is not asked.

    Raises:
        ScanError: as `OccupancyEstimator.estimate`.
        PartError, WeightsError: the part's files cannot be read.
    """
    estimator = tuned_estimator(estimator, part)
    said = estimator.estimate(volume, part.unit_volume)
    history = scans_of_same_rig(part.counted, volume)
    reasons = said.reasons + ((Reason.PART_UNUSED,) if part.overridden else ())
    if part.counted and not history:
        reasons += (Reason.CALIBRATED_ELSEWHERE,)
    models = part.models or (other_parts() if history else None)
    if models is not None and (volume.top is None or volume.container.kind in ("none", "hull")):
        models, reasons = None, (*reasons, Reason.PART_UNUSED)
    if models is None or not volume.stack_volume > 0:
        spread = np.hypot(said.gamma_std / said.gamma, part.relative_std)
        return replace(said, gamma_std=said.gamma * float(spread), reasons=reasons)
    model = models.one_side if volume.one_side else models.arc
    heard = np.log(said.gamma) if models.estimator == said.estimator else np.nan
    if np.isnan(heard):
        reasons += (Reason.ESTIMATOR_UNHEARD,)
    scan = Reading(*size_of(volume, part.unit_volume), float(heard))
    belief = model.believe(scan, [s.reading(models.estimator) for s in history],
                           part.relative_std)
    if not model.covers(scan):
        reasons += (Reason.FILL_UNLIKE_PILES,)
    wider = max(abs(belief.surprise) / _DISAGREE, 1.0)
    if wider > 1:
        reasons += (Reason.PART_DISAGREES,)
    gamma = min(float(np.exp(belief.mean)), _LARGEST_GAMMA)
    return OccupancyEstimate(gamma, gamma * belief.std * wider, model.scores, said.estimator,
                             reasons, belief.shares, len(history))
