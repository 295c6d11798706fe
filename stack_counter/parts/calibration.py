"""What one counted bin says of a part on this rig: `stack-counter part calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import date

import numpy as np

from stack_counter.counting import make_count
from stack_counter.errors import PartError
from stack_counter.occupancy.baselines import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.counted_scan import CountedScan, focal_of, scans_of_same_rig
from stack_counter.parts.gamma_model import size_of
from stack_counter.parts.informed_gamma import estimate_occupancy, other_parts, tuned_estimator
from stack_counter.types import StackCount, StackVolume

_IMPLAUSIBLE = 3.0  # times the estimate, either way: a slip of the pen, or another bin
_DRIFT = 3.0  # standard deviations


@dataclass(frozen=True)
class Counted:
    """A counted scan, what would have been said of it, and by how many standard deviations it
    disagrees with those before it (0 without any)."""

    scan: CountedScan
    before: StackCount
    drift: float

    @property
    def drifted(self) -> bool:
        """Whether something has changed since."""
        return abs(self.drift) > _DRIFT


def count_from_weight(part: Part, weight: float, piece_weight: float) -> int:
    """How many parts weigh that much.

    Args:
        part: its density and v say what a piece weighs where that is not given.
        weight: of all parts, kg.
        piece_weight: g; 0 where not given.

    Raises:
        PartError: no piece weight and no density, a v that is itself estimated, or a weight that
            is no positive number.
    """
    each = piece_weight or part.density * part.unit_volume * 1e3
    if not each:
        raise PartError(f"part '{part.name}' has no density_g_cm3 and no piece weight is given; "
                        "expected one of them")
    if part.unit_volume_std and not piece_weight:
        raise PartError(f"v of part '{part.name}' is known to {part.relative_std:.1%}, and so is "
                        "a weight by its density; expected the weight of a piece")
    if not (np.isfinite([weight, each]).all() and weight > 0 and each > 0):
        raise PartError(f"{weight} kg of pieces of {each} g; expected numbers above 0")
    return round(weight * 1e3 / each)


def counted_scan(part: Part, volume: StackVolume, count: int, estimator: OccupancyEstimator,
                 bag: str, confidence: float, force: bool) -> Counted:
    """A scan of which the count is known.

    Args:
        part: with its history.
        volume: of the scan.
        count: parts in it.
        bag: name of its recording.
        confidence: of the interval that `before` gets.
        force: take it although it is implausible, or of another rig than those before.

    Raises:
        PartError: it cannot be used, or is refused without `force`.
        ScanError: no gamma can be said.
    """
    before = make_count(volume, part.unit_volume, estimate_occupancy(volume, part, estimator),
                        confidence)
    if count < 1:
        raise PartError(f"{count} parts counted, {before.count} estimated; expected 1 or more: "
                        "an empty bin says nothing of gamma")
    if volume.top is None or volume.container.kind in ("none", "hull"):
        raise PartError(f"the scan's container is '{volume.container.kind}'; expected depth and a "
                        "container: without them V is not the same from scan to scan")
    ratio = count / max(before.count, 1)
    if not force and not 1 / _IMPLAUSIBLE < ratio < _IMPLAUSIBLE:
        raise PartError(f"{count} parts counted, {before.count} estimated; expected a ratio "
                        f"within {_IMPLAUSIBLE:g}; --force takes it all the same")
    if not volume.stack_volume > (0.0 if force else count * part.unit_volume):
        raise PartError(f"{count} parts of {part.unit_volume * 1e6:.4g} cm3 counted in a stack of "
                        f"{volume.stack_volume * 1e6:.4g} cm3; expected less than it holds")
    estimator = tuned_estimator(estimator, part)
    said = float(np.log(estimator.estimate(volume, part.unit_volume).gamma))
    height, width = size_of(volume, part.unit_volume)
    scan = CountedScan(
        str(date.today()), bag, count,
        float(np.log(count * part.unit_volume / volume.stack_volume)), said, estimator.name,
        height, width, volume.one_side, volume.container.kind,
        tuple(float(x) for x in volume.container.inner_size_m), focal_of(volume))
    if not force:
        _check_new(scan, part.counted, volume)
    return Counted(scan, before, _drift(part, volume, scan))


def _check_new(scan: CountedScan, history: Sequence[CountedScan], volume: StackVolume) -> None:
    """Raises PartError if a scan is of a rig that no other one is of, or is one of those."""
    for old in history:
        if old.bag == scan.bag and np.allclose([old.height, old.said], [scan.height, scan.said],
                                               atol=1e-4):
            raise PartError(f"{scan.bag} is there already, of {old.date}, {old.count} parts; "
                            "expected another scan; --force takes it all the same")
    whys = [old.rig_difference(volume) for old in history]
    if all(whys) and whys:
        raise PartError(f"{scan.bag} shows {whys[-1]}; --force takes it all the same, for that "
                        "other rig")


def _drift(part: Part, volume: StackVolume, scan: CountedScan) -> float:
    history = scans_of_same_rig(part.counted, volume)
    if not history:
        return 0.0
    models = part.models or other_parts()
    model = models.one_side if scan.one_side else models.arc
    return model.expected_count_error(
        scan.reading(models.estimator), [s.reading(models.estimator) for s in history],
        part.relative_std)
