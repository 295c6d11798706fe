# SPDX-License-Identifier: Apache-2.0
"""What a scan gives: its volume, an estimate of gamma, the count."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from stack_counter.types.filling_level import FillingLevel
from stack_counter.types.reasons import Reason
from stack_counter.types.shapes import Container, HeightMap, Mesh
from stack_counter.types.views import KeyView, ViewTally
from stack_counter.types.visible_parts import VisiblePart


@dataclass(frozen=True, eq=False)
class StackVolume:
    """The stack as reconstructed from one scan.

    Attributes:
        stamp_ns: stamp of the last view used.
        stack_volume, stack_volume_std: V and its standard deviation, m3.
        container: fitted or configured.
        fill_level: min, mean and max of the filled share of the inner height; zeros if unknown.
        coverage: share of the interior's footprint that some view saw, 0 to 1.
        top: highest surface inside the rim opening; None where only a hull is known.
        inner: inner surface of the container (floor) on the same grid.
        key_view: None if no view showed parts.
        views: tally of the scan so far.
        reasons: what qualifies the result.
        seconds: time spent by stage, s.
        mesh: carved surface, world frame, for display.
        missing_cameras: names of the rig's cameras that gave no view.
        one_side: all views look from nearly the same direction, as those of one fixed camera.
        region: name of the configured region that was measured; empty if none is named.
        view_agreement_m: median distance between the surfaces that different views show of one
            place, metres; 0 if unknown, as with one view.
        resolution_m: length that the top surface resolves, metres: the larger of the voxel and
            of what is compared in the images, a pixel of depth or stereo's window; 0 if unknown.
        volume_parts: what V is made of, m3, together V: `seen`, `filled` in where no view saw,
            and `wall`, beside a wall, where the height is that of what lies next to it; empty
            if unknown, as in a volume that came by message.
        filling_level: over a grid on the container's floor; None where there is no container.
    """

    stamp_ns: int
    stack_volume: float
    stack_volume_std: float
    container: Container
    fill_level: tuple[float, float, float]
    coverage: float
    top: HeightMap | None
    inner: HeightMap | None
    key_view: KeyView | None
    views: ViewTally
    reasons: tuple[Reason, ...] = ()
    seconds: dict[str, float] = field(default_factory=dict)
    mesh: Mesh | None = None
    missing_cameras: tuple[str, ...] = ()
    one_side: bool = False
    region: str = ""
    view_agreement_m: float = 0.0
    resolution_m: float = 0.0
    volume_parts: dict[str, float] = field(default_factory=dict)
    filling_level: FillingLevel | None = None

    @property
    def overfilled(self) -> bool:
        """Parts stand above the rim."""
        return self.fill_level[2] > 1

    def with_missing_cameras(self, cameras: Iterable[str]) -> StackVolume:
        """The volume of a scan to which these cameras gave nothing."""
        missing = tuple(cameras)
        reasons = self.reasons + ((Reason.CAMERA_MISSING,) if missing else ())
        return replace(self, missing_cameras=missing, reasons=reasons)


@dataclass(frozen=True, eq=False)
class OccupancyEstimate:
    """gamma with its relative error.

    Attributes:
        gamma: estimated occupancy ratio, 0 to 1.
        gamma_std: its standard deviation.
        scores: (n,) float64: on data whose families of parts the estimator had not seen, the log
            of true over estimated, in its relative standard deviations; the interval comes from
            their quantiles.
        estimator: name, e.g. `depth_corrected (baseline)`.
        reasons: what qualifies the estimate.
        shares: what gamma comes from and how much each weighed, together 1: `estimator`, `piles`
            of this part, `counted` scans of it, `training` piles of other parts.
        counted_scans: of this part on this rig that it rests on.
    """

    gamma: float
    gamma_std: float
    scores: np.ndarray
    estimator: str
    reasons: tuple[Reason, ...] = ()
    shares: dict[str, float] = field(default_factory=lambda: {"estimator": 1.0})
    counted_scans: int = 0


@dataclass(frozen=True)
class SourceCount:
    """What one source alone says of the number of parts.

    Attributes:
        source: `vision` (gamma * V / v) or `weight` (of the parts, over that of a piece).
        count: parts.
        count_interval: (low, high) with low <= count <= high, of the joined count's confidence.
        share: how much it weighs in the joined count; those of all sources are 1 together.
    """

    source: str
    count: int
    count_interval: tuple[int, int]
    share: float


@dataclass(frozen=True, eq=False)
class StackCount:
    """The answer: how many parts, and how sure.

    Attributes:
        count: parts in the stack.
        count_interval: (low, high) with low <= count <= high.
        confidence: probability that the interval holds the true count.
        gamma, gamma_std: occupancy ratio and its standard deviation.
        unit_volume: volume of one part, m3.
        volume: what gamma was multiplied with.
        estimator: name of the estimator of gamma.
        gamma_shares: how much it and what is known of the part weighed; see `OccupancyEstimate`.
        counted_scans: that gamma rests on.
        status: `ok`, or `degraded` where one of the reasons degrades.
        reasons: what qualifies the count.
        seconds: time spent by stage, s.
        distribution: (n,) float64 counts, rising, each as likely as the others: the estimator's
            scores times the relative standard deviation, or joined with a weight; None in a count
            that came by message.
        sources: what each source alone says, vision first.
        net_weight_kg: weight of the parts, kg; None where no weight was used.
        visible_parts: those that show from straight above, the surest first; None where none were
            looked for: there is no network for it, or no surface that it could read.
    """

    count: int
    count_interval: tuple[int, int]
    confidence: float
    gamma: float
    gamma_std: float
    unit_volume: float
    volume: StackVolume
    estimator: str
    status: str = "ok"
    reasons: tuple[Reason, ...] = ()
    gamma_shares: dict[str, float] = field(default_factory=lambda: {"estimator": 1.0})
    counted_scans: int = 0
    seconds: dict[str, float] = field(default_factory=dict)
    distribution: np.ndarray | None = None
    sources: tuple[SourceCount, ...] = ()
    net_weight_kg: float | None = None
    visible_parts: tuple[VisiblePart, ...] | None = None
