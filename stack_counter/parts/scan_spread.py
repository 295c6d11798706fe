# SPDX-License-Identifier: Apache-2.0
"""How much less a part's models say of scans unlike those that they were fitted to.

The models of a part rest on piles in open containers, seen with depth. A heap, a closed container
and depth from pictures are read by them all the same, with an expected change of log gamma and a
wider spread.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from stack_counter.types import Reason, StackVolume


@dataclass(frozen=True)
class ScanSpread:
    """What a kind of scan changes of log gamma, true (t) and estimated (y).

    Attributes:
        shift: expected change of t; the estimator sees it, so y changes alike.
        std: standard deviation of that change.
        estimator_std: standard deviation of a change of y alone.
    """

    shift: float = 0.0
    std: float = 0.0
    estimator_std: float = 0.0

    def __add__(self, other: ScanSpread) -> ScanSpread:
        """Both changes, which do not depend on each other."""
        return ScanSpread(self.shift + other.shift, math.hypot(self.std, other.std),
                          math.hypot(self.estimator_std, other.estimator_std))

    @property
    def covariance(self) -> np.ndarray:
        """(2, 2) float64 covariance of the changes of t and y."""
        return np.array([[self.std**2, self.std**2],
                         [self.std**2, self.std**2 + self.estimator_std**2]])


@dataclass(frozen=True)
class ScanSpreadSettings:
    """What each kind of scan changes. The numbers are of log gamma.

    Attributes:
        heap: parts without a container. `python -m stack_counter.train.heap_spread
            data/train-deep --scenes 1200`: 146 heaps against piles of the same part in open
            containers are denser by 0.12, as much of a heap is higher than its mean, +- 0.112,
            to which a container's own 0.059 adds 0.075. The network's gamma is off by 0.077 on
            heaps and by 0.058 on all (docs/gamma.md), 0.15 of log gamma more.
        closed: a closed container, carved by labels and depth. Derived: its film may fall into
            the gaps of the surface (the heap's +0.12) or bridge them (-0.24: a ball of a part
            length that rolls over the same piles, where they are deep); all between is as likely.
            And goods in packages have been shaken, which piles are poured: +0.1 +- 0.09, balls and
            M&M's in the densest state over the poured one (docs/simulator.md: +0.06, +0.13).
        outline: the hull of outlines alone, which holds all below a container's rim, and its
            walls. Log of its V over the true one on three training scenes, seen in 20 views:
            0.30 (a heap), 0.54 (a box), 1.78 (a bowl); gamma is not changed for an error of V,
            and there is no surface for an estimator to read.
        pictures: depth from pictures, in addition. It is too smooth: a real bag of noodles is read
            25% too full (docs/figures.md). That V is off in its own way is chosen.
        other_rig: a container unlike those of all counted scans, in addition. Of 152 pairs of
            piles in two containers (`data/train-deep`, one part, friction within 0.1), gamma of
            one told by the other is off by 0.104, of which a model's own noise explains 0.047.
        shared_share: share of the variance that all scans of one kind have in common, as they
            have their container; chosen.
    """

    heap: ScanSpread = ScanSpread(0.12, 0.08, 0.15)
    closed: ScanSpread = ScanSpread(0.04, 0.15, 0.15)
    outline: ScanSpread = ScanSpread(0.0, 1.0)
    pictures: ScanSpread = ScanSpread(0.0, 0.05, 0.25)
    other_rig: ScanSpread = ScanSpread(0.0, 0.09)
    shared_share: float = 0.5


SETTINGS = ScanSpreadSettings()
NO_SPREAD = ScanSpread()


def spread_of(volume: StackVolume) -> ScanSpread:
    """What a scan changes of log gamma; nothing of an open container seen with depth."""
    if volume.top is None:
        return SETTINGS.outline
    spread = spread_of_kind(volume.container.kind)
    from_pictures = Reason.DEPTH_FROM_PICTURES in volume.reasons
    return spread + SETTINGS.pictures if from_pictures else spread


def spread_of_kind(container_kind: str) -> ScanSpread:
    """The same of a container's kind alone."""
    return {"none": SETTINGS.heap, "hull": SETTINGS.closed}.get(container_kind, NO_SPREAD)
