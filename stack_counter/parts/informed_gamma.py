# SPDX-License-Identifier: Apache-2.0
"""gamma of a part of which more is known than v: simulated piles of it, or counted bins."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache, lru_cache
from pathlib import Path

import numpy as np

from stack_counter.files import shipped_weights
from stack_counter.occupancy import OccupancyEstimator
from stack_counter.occupancy.network import NetworkEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import CountedScan, scans_of_same_rig
from stack_counter.parts.gamma_model import Reading, fill_size
from stack_counter.parts.part_models import PartModels, read_models
from stack_counter.parts.scan_spread import NO_SPREAD, ScanSpread, spread_of, spread_of_kind
from stack_counter.parts.scan_spread import SETTINGS as SPREAD_SETTINGS
from stack_counter.types import OccupancyEstimate, Reason, StackVolume

# By how much is known of the form of a part
SHIPPED = ("parts.json", "parts_size.json", "parts_mesh.json")


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
def models_of_other_parts(estimator: str) -> PartModels:
    """What scans of one part have in common, from parts that the estimator had not seen.

    Where the file of an estimator of that name is not there, it is that of the one which knows
    v alone.
    """
    paths = map(shipped_weights, SHIPPED)
    models = [read_models(path) for path in paths if path.exists()]
    return next((m for m in models if m.estimator == estimator), models[0])


def estimator_of_part(estimator: OccupancyEstimator, part: Part) -> OccupancyEstimator:
    """The estimator as it knows a part: its form, and last layers that were tuned to it.

    Raises:
        WeightsError: the tuned layers cannot be read, or are another network's.
    """
    knowing = estimator.knowing(part.form)
    if part.tuned is None:
        return knowing
    if not isinstance(knowing, NetworkEstimator):
        return knowing
    return _tuned_network(knowing, part.tuned,
                          part.tuned.stat().st_mtime_ns if part.tuned.exists() else 0)


@lru_cache(maxsize=8)
def _tuned_network(network: NetworkEstimator, path: Path, changed_ns: int) -> NetworkEstimator:
    return network.tuned(path)


def estimate_occupancy(volume: StackVolume, part: Part, estimator: OccupancyEstimator
                       ) -> OccupancyEstimate:
    """Estimates gamma by the estimator, joined with what is known of the part.

    It may add the reasons `part_unused`, `calibrated_elsewhere`, `container_unlike_piles`,
    `estimator_unheard`, `fill_unlike_piles` and `part_disagrees`.

    Raises:
        ScanError: the estimator can say no gamma of this scan.
        PartError: the part's models cannot be read.
        WeightsError: the part's tuned layers cannot be read.
    """
    estimate = estimator_of_part(estimator, part).estimate(volume, part.unit_volume)
    # Choose what is known: models of the part's own piles, else what other parts tell of counted
    # scans.
    history = _relevant_scans(part.counted, volume)
    models = part.models or (models_of_other_parts(estimate.estimator) if history else None)
    reasons = estimate.reasons + _known_reasons(part, volume, known=models is not None)
    if models is None or not volume.stack_volume > 0:
        spread = np.hypot(estimate.gamma_std / estimate.gamma, part.relative_std)
        return replace(estimate, gamma_std=estimate.gamma * float(spread), reasons=reasons)
    # Join it with the estimate, if that was read from a surface and the models know the estimator.
    model = models.one_side if volume.one_side else models.arc
    log_gamma = np.nan
    if volume.top is not None and models.estimator == estimate.estimator:
        log_gamma = np.log(estimate.gamma)
    elif volume.top is not None:
        reasons += (Reason.ESTIMATOR_UNHEARD,)
    scan = Reading(*fill_size(volume, part.unit_volume), float(log_gamma),
                   spread=spread_of(volume))
    counted = [s.reading(models.estimator, spread) for s, spread in history]
    if part.models is None and Reason.CALIBRATED_ELSEWHERE in reasons:
        scan, counted = _of_another_rig(scan, counted)
    posterior = model.posterior(scan, counted, part.relative_std)
    # Widen the spread where the estimate is far off what is known.
    if not model.covers(scan):
        reasons += (Reason.FILL_UNLIKE_PILES,)
    widening = max(abs(posterior.estimator_z_score) / SETTINGS.max_z_score, 1.0)
    if widening > 1:
        reasons += (Reason.PART_DISAGREES,)
    gamma = min(float(np.exp(posterior.mean)), SETTINGS.max_gamma)
    return OccupancyEstimate(gamma, gamma * posterior.std * widening, model.scores,
                             estimate.estimator, reasons, posterior.shares, len(history))


def _relevant_scans(history: Sequence[CountedScan], volume: StackVolume
                    ) -> list[tuple[CountedScan, ScanSpread]]:
    """Counted scans that tell something of a scan, each with what its kind changes.

    They are those of the same rig. Where there is none, and the scan is not one of an open
    container with depth, which the spread allows for, they are all that are seen from as many
    sides.
    """
    spread, same_rig = spread_of(volume), scans_of_same_rig(history, volume)
    if same_rig or spread == NO_SPREAD:
        return [(scan, spread) for scan in same_rig]
    return [(scan, spread_of_kind(scan.container)) for scan in history
            if scan.one_side == volume.one_side]


def _of_another_rig(scan: Reading, counted: Sequence[Reading]) -> tuple[Reading, list[Reading]]:
    """The readings for models of other parts, where no counted scan is of the scan's rig.

    Log gamma goes with the width w by 3.5 / w from part to part, as it does in these models, but
    by -0.3 / w between containers of one part: so all count as equally wide.
    """
    return (replace(scan, spread=scan.spread + SPREAD_SETTINGS.other_rig),
            [replace(reading, width=scan.width) for reading in counted])


def _known_reasons(part: Part, volume: StackVolume, known: bool) -> tuple[Reason, ...]:
    """What qualifies the use of what is `known` of a part for a scan."""
    same_rig = scans_of_same_rig(part.counted, volume)
    holds = {
        Reason.PART_UNUSED: part.overridden,
        Reason.CALIBRATED_ELSEWHERE: part.counted and not same_rig,
        Reason.CONTAINER_UNLIKE_PILES: known and not same_rig and spread_of(volume) != NO_SPREAD,
    }
    return tuple(reason for reason, is_so in holds.items() if is_so)
