# SPDX-License-Identifier: Apache-2.0
"""Counted scans of a part: what each one found, and whether another is of the same rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stack_counter.parts.gamma_model import Reading
from stack_counter.parts.scan_spread import ScanSpread
from stack_counter.types import StackVolume


@dataclass(frozen=True)
class SameRigSettings:
    """How far scans of one rig may differ.

    Attributes:
        size_tolerance: relative, of the inner sides of a container that is measured each time;
            chosen.
        focal_tolerance: relative, of a camera's focal length; chosen.
    """

    size_tolerance: float = 0.15
    focal_tolerance: float = 0.02


SETTINGS = SameRigSettings()


@dataclass(frozen=True)
class CountedScan:
    """One bin of known count. The fields are keys of the part catalogue.

    Attributes:
        date: when it was added.
        bag: name of its recording.
        count: number of parts in it.
        log_gamma: log of count * v / V.
        said: log of the gamma that `estimator` gave.
        estimator: name of the estimator.
        height: mean height of the fill, part lengths.
        width: root of the footprint's area, part lengths.
        one_side: whether it was seen from one side only.
        container: kind of its container.
        inner_size_m: inner sides of the container, metres; zeros where they are not known.
        focal_px: focal length of the key view's camera, pixels; 0 where there is none.
    """

    date: str
    bag: str
    count: int
    log_gamma: float
    said: float
    estimator: str
    height: float
    width: float
    one_side: bool
    container: str
    inner_size_m: tuple[float, ...]
    focal_px: float

    def checked(self) -> CountedScan:
        """This scan, if its numbers can be.

        Raises:
            ValueError: a number is not finite, or is not above 0 where it must be.
        """
        numbers = (self.log_gamma, self.said, *self.inner_size_m, self.focal_px)
        if not (isinstance(self.count, int) and self.count > 0 and self.height > 0
                and self.width > 0 and all(map(math.isfinite, numbers))
                and len(self.inner_size_m) == 3):
            raise ValueError(f"counted scan {asdict(self)} (finite numbers, a count, height and "
                             "width above 0 needed)")
        return self

    def reading(self, estimator: str, spread: ScanSpread) -> Reading:
        """This scan for a part's model; the gamma of another estimator is left out.

        `spread`: what this kind of scan changes of log gamma.
        """
        estimated = self.said if estimator == self.estimator else math.nan
        return Reading(self.height, self.width, estimated, self.log_gamma, spread)

    def rig_difference(self, volume: StackVolume) -> str:
        """Text that says in what a scan differs from this one's rig; empty if in nothing."""
        kind, size = volume.container.kind, np.array(volume.container.inner_size_m)
        if kind != self.container:
            return f"container '{kind}'; expected '{self.container}', as on {self.date}"
        own_size = np.array(self.inner_size_m)
        if own_size.any() and size.any():
            ratios = _shorter_first(size) / np.maximum(_shorter_first(own_size), 1e-9)
            if (np.abs(ratios - 1) > SETTINGS.size_tolerance).any():
                return (f"a container of {_in_mm(size)} mm; expected about {_in_mm(own_size)} mm, "
                        f"as on {self.date}")
        focal = focal_length_of(volume)
        if focal and self.focal_px and abs(focal / self.focal_px - 1) > SETTINGS.focal_tolerance:
            return (f"a camera of {focal:.0f} px focal length; expected {self.focal_px:.0f} px, "
                    f"as on {self.date}")
        return ""

    def as_entry(self) -> dict[str, Any]:
        """What the part catalogue holds of this scan, by key; numbers of six digits."""
        values = {key: float(f"{value:.6g}") if isinstance(value, float) else value
                  for key, value in asdict(self).items()}
        return {**values, "inner_size_m": [float(f"{x:.6g}") for x in self.inner_size_m]}


def scans_of_same_rig(history: Sequence[CountedScan], volume: StackVolume) -> list[CountedScan]:
    """Counted scans of the same rig, seen from as many sides."""
    return [scan for scan in history
            if scan.one_side == volume.one_side and not scan.rig_difference(volume)]


def focal_length_of(volume: StackVolume) -> float:
    """Focal length of the key view's camera, pixels; 0 without one."""
    return float(volume.key_view.intrinsics.fx) if volume.key_view else 0.0


def _shorter_first(size: np.ndarray) -> np.ndarray:
    """(3,) sizes, the shorter side first: which one is x is chance, from scan to scan."""
    return np.append(np.sort(size[:2]), size[2])


def _in_mm(size: np.ndarray) -> str:
    return " x ".join(f"{1000 * s:.0f}" for s in size)
