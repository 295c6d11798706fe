"""Counted scans of a part: what each one found, and whether another is of the same rig."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from stack_counter.parts.gamma_model import Reading
from stack_counter.types import StackVolume

_SAME_SIZE = 0.15  # relative, of the inner sides of a container that is measured each time
_SAME_FOCAL = 0.02  # relative, of a camera's focal length


@dataclass(frozen=True)
class CountedScan:
    """One bin of known count.

    Attributes:
        date: when it was added; `bag`: name of its recording.
        count: parts in it.
        log_gamma: log of count * v / V.
        said: log of the gamma that `estimator` said.
        height, width: of the fill in part lengths: see `part_model.Reading`.
        one_side: it was seen from one side only.
        container, inner_size_m: as found; zeros where not known.
        focal_px: focal length of the key view's camera; 0 where there is none.
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
        """Itself.

        Raises:
            ValueError: a number that cannot be.
        """
        numbers = (self.log_gamma, self.said, *self.inner_size_m, self.focal_px)
        if not (isinstance(self.count, int) and self.count > 0 and self.height > 0
                and self.width > 0 and all(map(math.isfinite, numbers))
                and len(self.inner_size_m) == 3):
            raise ValueError(f"counted scan {asdict(self)} (finite numbers, a count, height and "
                             "width above 0 needed)")
        return self

    def reading(self, estimator: str) -> Reading:
        """For the part's model; what another estimator said is left out."""
        said = self.said if estimator == self.estimator else math.nan
        return Reading(self.height, self.width, said, self.log_gamma)

    def rig_difference(self, volume: StackVolume) -> str:
        """In what a scan differs from this one's rig; empty if in nothing."""
        kind, size = volume.container.kind, np.array(volume.container.inner_size_m)
        if kind != self.container:
            return f"container '{kind}'; expected '{self.container}', as on {self.date}"
        mine = np.array(self.inner_size_m)
        if mine.any() and size.any() and (np.abs(_sorted(size) / np.maximum(_sorted(mine), 1e-9)
                                                 - 1) > _SAME_SIZE).any():
            return (f"a container of {_mm(size)} mm; expected about {_mm(mine)} mm, as on "
                    f"{self.date}")
        focal = focal_of(volume)
        if focal and self.focal_px and abs(focal / self.focal_px - 1) > _SAME_FOCAL:
            return (f"a camera of {focal:.0f} px focal length; expected {self.focal_px:.0f} px, "
                    f"as on {self.date}")
        return ""

    def as_entry(self) -> dict[str, Any]:
        """What the part catalogue holds of this scan, by key; numbers of six digits."""
        values = {key: float(f"{value:.6g}") if isinstance(value, float) else value
                  for key, value in asdict(self).items()}
        return {**values, "inner_size_m": [float(f"{x:.6g}") for x in self.inner_size_m]}


def scans_of_same_rig(history: Sequence[CountedScan], volume: StackVolume) -> list[CountedScan]:
    """Those counted scans that say something of a scan: of the same rig and way of looking."""
    return [scan for scan in history
            if scan.one_side == volume.one_side and not scan.rig_difference(volume)]


def focal_of(volume: StackVolume) -> float:
    """Focal length of the key view's camera, pixels; 0 without one."""
    return float(volume.key_view.intrinsics.fx) if volume.key_view else 0.0


def _sorted(size: np.ndarray) -> np.ndarray:
    """The shorter side first: which one is x is chance, from scan to scan."""
    return np.append(np.sort(size[:2]), size[2])


def _mm(size: np.ndarray) -> str:
    return " x ".join(f"{1000 * s:.0f}" for s in size)
