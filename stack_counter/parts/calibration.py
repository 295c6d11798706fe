# SPDX-License-Identifier: Apache-2.0
"""What one counted bin tells of a part on this rig: `stack-counter part calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import date

import numpy as np

from stack_counter.counting import make_count
from stack_counter.errors import PartError
from stack_counter.occupancy import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import CountedScan, focal_length_of, scans_of_same_rig
from stack_counter.parts.gamma_model import fill_size
from stack_counter.parts.informed_gamma import (
    estimate_occupancy,
    estimator_of_part,
    models_of_other_parts,
)
from stack_counter.parts.scan_spread import spread_of
from stack_counter.types import StackCount, StackVolume


@dataclass(frozen=True)
class CalibrationSettings:
    """Which counted bins are taken, and which are warned of.

    Attributes:
        max_ratio: of count and estimate, either way; beyond, the count is a slip of the pen or
            another bin's. Chosen.
        max_drift: standard deviations by which a bin may disagree with those before; chosen.
        same_volume: relative change of v above which a part is another one; chosen.
        same_volume_z: the same for a v that was measured, in its standard deviations; chosen.
    """

    max_ratio: float = 3.0
    max_drift: float = 3.0
    same_volume: float = 0.01
    same_volume_z: float = 3.0


SETTINGS = CalibrationSettings()


@dataclass(frozen=True, eq=False)
class Calibration:
    """A counted scan beside what was known before it.

    Attributes:
        scan: the counted one.
        count_without_it: count of the same scan by what was known before.
        drift: standard deviations by which it disagrees with the counted scans before it; 0
            without any.
    """

    scan: CountedScan
    count_without_it: StackCount
    drift: float

    @property
    def drifted(self) -> bool:
        """Whether the part, the rig or the count seems to have changed since."""
        return abs(self.drift) > SETTINGS.max_drift


def count_from_weight(part: Part, weight: float, piece_weight: float) -> int:
    """Number of parts of a weight.

    Args:
        part: by its own, or by density and v, the weight of a piece follows if it is not given.
        weight: of all parts, kg.
        piece_weight: of one part, g; 0 where it is not given.

    Raises:
        PartError: there is neither piece weight nor density, v is itself estimated, or a weight
            is no positive number.
    """
    if part.piece_weight and not piece_weight:
        piece_weight = 1e3 * part.piece_weight.mean_kg
    each = piece_weight or part.density * part.unit_volume * 1e3
    if not each:
        raise PartError(f"part '{part.name}' has neither piece_weight_g nor density_g_cm3, and no "
                        "piece weight is given; expected one of them")
    if part.unit_volume_std and not piece_weight:
        raise PartError(f"v of part '{part.name}' is known to {part.relative_std:.1%}, and so is "
                        "a weight by its density; expected the weight of a piece")
    if not (np.isfinite([weight, each]).all() and weight > 0 and each > 0):
        raise PartError(f"{weight} kg of pieces of {each} g; expected numbers above 0")
    return round(weight * 1e3 / each)


def calibrate(part: Part, volume: StackVolume, count: int, estimator: OccupancyEstimator,
              bag: str, confidence: float, force: bool) -> Calibration:
    """Makes a counted scan of a scan of which the count is known.

    Args:
        part: with its history.
        volume: of the scan.
        count: number of parts in it.
        estimator: of gamma.
        bag: name of the recording.
        confidence: of the interval of `count_without_it`.
        force: whether it is taken although it is implausible, or of another rig than those
            before.

    Raises:
        PartError: the scan cannot be used, or is refused without `force`.
        ScanError: the estimator can say no gamma of this scan.
    """
    estimate = estimate_occupancy(volume, part, estimator)
    without_it = make_count(volume, part.unit_volume, estimate, confidence)
    _check_plausible(part, volume, count, without_it.count, force)
    scan = _counted_scan(part, volume, count, estimator_of_part(estimator, part), bag)
    if not force:
        _check_new(scan, part.counted, volume)
    return Calibration(scan, without_it, _drift_z_score(part, volume, scan))


def history_at_volume(old: Part | None, unit_volume: float, force: bool
                      ) -> tuple[CountedScan, ...]:
    """Counted bins of a part that is replaced by itself with another v.

    Args:
        old: the part as it was; None where it was not known.
        unit_volume: the new v, m3.
        force: whether the bins are forgotten where v differs by more than its own error.

    Raises:
        PartError: v differs by more, without `force`.
    """
    if old is None:
        return ()
    ratio = unit_volume / old.unit_volume
    tolerance = max(SETTINGS.same_volume, SETTINGS.same_volume_z * old.relative_std)
    if abs(ratio - 1) < tolerance:
        return tuple(replace(scan, log_gamma=scan.log_gamma + float(np.log(ratio)))
                     for scan in old.counted)
    if not force:
        raise PartError(f"part '{old.name}' is there with v {old.unit_volume * 1e6:.6g} cm3; "
                        f"expected about that, not {unit_volume * 1e6:.6g} cm3 (--force replaces "
                        f"it and forgets its counted bins: {len(old.counted)})")
    return ()


def _check_plausible(part: Part, volume: StackVolume, count: int, estimated: int, force: bool
                     ) -> None:
    """Refuses a count that cannot be, or a scan whose V is another each time."""
    if count < 1:
        raise PartError(f"{count} parts counted, {estimated} estimated; expected 1 or more: "
                        "an empty bin says nothing of gamma")
    if volume.top is None:
        raise PartError("the scan gave the hull of its outlines alone; expected depth, or "
                        "pictures in colour: such a V is not the same from scan to scan")
    ratio = count / max(estimated, 1)
    if not force and not 1 / SETTINGS.max_ratio < ratio < SETTINGS.max_ratio:
        raise PartError(f"{count} parts counted, {estimated} estimated; expected a ratio "
                        f"within {SETTINGS.max_ratio:g}; --force takes it all the same")
    if not volume.stack_volume > (0.0 if force else count * part.unit_volume):
        raise PartError(f"{count} parts of {part.unit_volume * 1e6:.4g} cm3 counted in a stack of "
                        f"{volume.stack_volume * 1e6:.4g} cm3; expected less than it holds")


def _counted_scan(part: Part, volume: StackVolume, count: int, estimator: OccupancyEstimator,
                  bag: str) -> CountedScan:
    gamma = estimator.estimate(volume, part.unit_volume).gamma
    size, container = fill_size(volume, part.unit_volume), volume.container
    return CountedScan(
        date=str(date.today()), bag=bag, count=count,
        log_gamma=float(np.log(count * part.unit_volume / volume.stack_volume)),
        said=float(np.log(gamma)), estimator=estimator.name, height=size.height,
        width=size.width, one_side=volume.one_side, container=container.kind,
        inner_size_m=tuple(float(x) for x in container.inner_size_m),
        focal_px=focal_length_of(volume))


def _check_new(scan: CountedScan, history: Sequence[CountedScan], volume: StackVolume) -> None:
    """Refuses a scan that is in the history already, or of a rig that no scan in it is of."""
    for old in history:
        if old.bag == scan.bag and np.allclose([old.height, old.said], [scan.height, scan.said],
                                               atol=1e-4):
            raise PartError(f"{scan.bag} is there already, of {old.date}, {old.count} parts; "
                            "expected another scan; --force takes it all the same")
    differences = [old.rig_difference(volume) for old in history]
    if differences and all(differences):
        raise PartError(f"{scan.bag} shows {differences[-1]}; --force takes it all the same, for "
                        "that other rig")


def _drift_z_score(part: Part, volume: StackVolume, scan: CountedScan) -> float:
    """Standard deviations by which a scan disagrees with those before; 0 without any."""
    history = scans_of_same_rig(part.counted, volume)
    if not history:
        return 0.0
    models = part.models or models_of_other_parts(scan.estimator)
    model = models.one_side if scan.one_side else models.arc
    reading, *before = (s.reading(models.estimator, spread_of(volume)) for s in (scan, *history))
    return model.counted_z_score(reading, before, part.relative_std)
