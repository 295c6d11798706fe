# SPDX-License-Identifier: Apache-2.0
"""What is known of one part's gamma, as one Gaussian over its scans.

Two numbers describe a scan of a part: t, the log of its true gamma (over the measured V), and y,
the log of the gamma that the estimator gives. Both are linear in the size of the fill, and share
with all other scans of that part on that rig an offset that is not known (friction; how the part
nests; how the network misreads it):

    (t, y) = (B + U) x + e,    x = (1, 1 / (h + 1/2), 1 / w),

h and w being fill height and container width in part lengths, U the same for all scans with
covariance `shared`, e new in each with covariance `noise`. A scan unlike those that the model was
fitted to adds its `ScanSpread`, partly shared by all of its kind. The estimate, t of a scan given
its y and counted scans (t, y), is then one conditional expectation: the network, the part's
simulated piles and the counted scans are joined by their variances.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np

from stack_counter.errors import ScanError
from stack_counter.parts.scan_spread import NO_SPREAD, ScanSpread
from stack_counter.parts.scan_spread import SETTINGS as SPREAD_SETTINGS
from stack_counter.types import StackVolume

FEATURES = 3


@dataclass(frozen=True)
class GammaModelSettings:
    """Tunables of the model.

    Attributes:
        height_offset: added to a fill's height, part lengths, so that a single layer is no
            singularity; chosen.
        min_variance_share: share of the variance of log gamma that stays when V's own is taken
            out; chosen.
    """

    height_offset: float = 0.5
    min_variance_share: float = 0.1


SETTINGS = GammaModelSettings()


class FillSize(NamedTuple):
    """Size of a fill in part lengths v**(1/3).

    Attributes:
        height: mean height over the footprint.
        width: root of the footprint's area.
    """

    height: float
    width: float


@dataclass(frozen=True)
class Reading:
    """What a model needs of one scan of a part.

    Attributes:
        height: mean height over the footprint, part lengths.
        width: root of the footprint's area, part lengths.
        log_gamma_estimated: log of the estimator's gamma; NaN if there is none to compare.
        log_gamma_counted: log of count * v / V; NaN if the scan is not counted.
        spread: what its kind of scan changes.
    """

    height: float
    width: float
    log_gamma_estimated: float = np.nan
    log_gamma_counted: float = np.nan
    spread: ScanSpread = NO_SPREAD


@dataclass(frozen=True)
class GammaPosterior:
    """Log gamma of a scan given all that is known.

    Attributes:
        mean: of log gamma.
        std: standard deviation of log gamma, V's own error taken out.
        shares: by source, how much of the mean comes from it; they sum to 1.
        estimator_z_score: by how many standard deviations the estimator is off what was expected
            of it; 0 without an estimate.
    """

    mean: float
    std: float
    shares: dict[str, float]
    estimator_z_score: float


@dataclass(frozen=True, eq=False)
class GammaModel:
    """The Gaussian of the module's docstring. All arrays are float64.

    Attributes:
        coefficients: (2, FEATURES) B; rows t, y.
        shared: (2 * FEATURES, 2 * FEATURES) covariance of U, t's coefficients first.
        noise: (2, 2) covariance of e.
        volume_variance: mean variance of log V that `noise` contains.
        scores: (n,) errors of t on piles left out, in their standard deviations.
        least: (2,) smallest height and width that it was fitted on, part lengths.
        friction: (2,) change of t and y per 1 of friction; NaN where it is not known.
        source: what the model was fitted to, as `shares` calls it: `piles` of this part, or
            `training` piles of others.
    """

    coefficients: np.ndarray
    shared: np.ndarray
    noise: np.ndarray
    volume_variance: float
    scores: np.ndarray
    least: np.ndarray
    friction: np.ndarray
    source: str

    def posterior(self, scan: Reading, counted: Sequence[Reading] = (), unit_std: float = 0.0
                  ) -> GammaPosterior:
        """Log gamma of a scan given its estimate and the counted scans.

        Args:
            scan: of which the count is asked for.
            counted: other scans of the part on the same rig.
            unit_std: relative standard deviation of v, an error that all scans share.
        """
        scans = [*counted, scan]
        prior_mean, prior = self._joint(scans, unit_std)
        values = _stacked_values(scans)
        t, y = len(scans) - 1, 2 * len(scans) - 1  # where the scan's own two numbers stand
        known = np.flatnonzero(np.isfinite(values))
        history = known[known != y]
        # Condition on the counted scans alone, then on the scan's estimate too.
        history_mean, by_history = condition_gaussian(prior_mean, prior, values, history)
        mean, by_all = condition_gaussian(prior_mean, prior, values, known)
        # Compare the estimate with what the history lets expect of it.
        estimator_weight, z_score = 0.0, 0.0
        if np.isfinite(scan.log_gamma_estimated):
            difference = scan.log_gamma_estimated - history_mean[y]
            estimator_weight = float(np.clip(by_history[t, y] / by_history[y, y], 0, 1))
            z_score = float(difference) / np.sqrt(by_history[y, y])
        # Take the error of V out of the variance: the count adds it by itself.
        std = np.sqrt(max(by_all[t, t] - self.volume_variance,
                          SETTINGS.min_variance_share * by_all[t, t]))
        own = self.noise[0, 0] + (1 - SPREAD_SETTINGS.shared_share) * scan.spread.std**2
        shares = self._shares(estimator_weight, prior[t, t] - own, by_history[t, t] - own,
                              bool(len(history)))
        return GammaPosterior(float(mean[t]), float(std), shares, float(z_score))

    def _shares(self, estimator_weight: float, prior: float, by_history: float,
                has_history: bool) -> dict[str, float]:
        """How much of the mean comes from each source.

        Args:
            estimator_weight: weight of the estimate.
            prior: variance of t before anything was counted, a scan's own apart.
            by_history: the same given the counted scans.
            has_history: whether there are counted scans.
        """
        learnt = float(np.clip(1 - by_history / prior, 0, 1)) if has_history else 0.0
        shares = {"estimator": estimator_weight,
                  self.source: (1 - estimator_weight) * (1 - learnt)}
        if has_history:
            shares["counted"] = (1 - estimator_weight) * learnt
        return shares

    def counted_z_score(self, scan: Reading, counted: Sequence[Reading], unit_std: float = 0.0
                        ) -> float:
        """By how many standard deviations a counted scan disagrees with those before it."""
        scans = [*counted, scan]
        mean, covariance = self._joint(scans, unit_std)
        values, t = _stacked_values(scans), len(counted)
        known = np.flatnonzero(np.isfinite(values))
        expected, spread = condition_gaussian(mean, covariance, values, known[known != t])
        return float((scan.log_gamma_counted - expected[t]) / np.sqrt(spread[t, t]))

    def gamma_at(self, height: float, width: float) -> tuple[float, float]:
        """Predicts gamma of a fill before any scan of it, and its standard deviation.

        Args:
            height: of the fill, part lengths.
            width: of the fill, part lengths.
        """
        mean, covariance = self._joint([Reading(height, width)], 0.0)
        gamma = float(np.exp(mean[0]))
        return gamma, gamma * float(np.sqrt(covariance[0, 0]))

    def covers(self, scan: Reading) -> bool:
        """Whether the model was fitted on such fills; large ones differ little."""
        return bool(scan.height >= self.least[0] and scan.width >= self.least[1])

    def _joint(self, scans: Sequence[Reading], unit_std: float) -> tuple[np.ndarray, np.ndarray]:
        """Mean (2 n,) and covariance (2 n, 2 n) of all t, then all y, of n scans."""
        x = fill_features(np.array([s.height for s in scans]), np.array([s.width for s in scans]))
        design = np.kron(np.eye(2), x)  # (2 n, 2 FEATURES)
        shared = self.shared.copy()
        shared[0, 0] += unit_std**2
        covariance = design @ shared @ design.T + np.kron(self.noise, np.eye(len(scans)))
        # Add what scans change that are unlike those of the fit.
        spreads = [scan.spread for scan in scans]
        for spread in set(spreads):
            alike = np.array([s == spread for s in spreads], float)
            common = SPREAD_SETTINGS.shared_share
            covariance += np.kron(spread.covariance, common * np.outer(alike, alike)
                                  + (1 - common) * np.diag(alike))
        shifts = np.tile([spread.shift for spread in spreads], 2)
        return design @ self.coefficients.ravel() + shifts, covariance

    @cached_property
    def per_tenth_of_friction(self) -> float:
        """Relative change of gamma per 0.1 of friction."""
        return float(np.exp(0.1 * self.friction[0]) - 1)

    def per_tenth_of_width(self, height: float, width: float) -> float:
        """Relative change of gamma where the container is taken to be 10% too wide."""
        too_wide, right = self.gamma_at(height, 1.1 * width)[0], self.gamma_at(height, width)[0]
        return too_wide / right - 1


def fill_features(height: np.ndarray, width: np.ndarray) -> np.ndarray:
    """(n, FEATURES) x of the module's docstring, of (n,) heights and widths in part lengths."""
    return np.stack([np.ones_like(height), 1 / (height + SETTINGS.height_offset), 1 / width],
                    axis=1)


def fill_size(volume: StackVolume, unit_volume: float) -> FillSize:
    """Measures the size of a fill in part lengths; of a hull alone that of a cube.

    Args:
        volume: of a scan.
        unit_volume: v, m3.

    Raises:
        ScanError: the scan shows no footprint.
    """
    if volume.top is None or volume.inner is None:
        side = float(np.cbrt(volume.stack_volume / unit_volume))
        return FillSize(side, side)
    cells = np.isfinite(volume.top.heights) & np.isfinite(volume.inner.heights)
    area = np.count_nonzero(cells) * volume.top.pitch**2
    if not area:
        raise ScanError(f"0 of {cells.size} cells of the top surface are finite; expected some")
    part_length = unit_volume ** (1 / 3)
    return FillSize(volume.stack_volume / area / part_length, float(np.sqrt(area)) / part_length)


def condition_gaussian(mean: np.ndarray, covariance: np.ndarray, values: np.ndarray,
                       known: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Conditions a Gaussian on some of its values.

    Args:
        mean: (n,).
        covariance: (n, n).
        values: (n,); those that are not known are not used.
        known: (m,) int indices of the values that are.

    Returns:
        Mean (n,) and covariance (n, n).
    """
    if not len(known):
        return mean, covariance
    gain = np.linalg.solve(covariance[np.ix_(known, known)], covariance[known]).T
    return (mean + gain @ (values[known] - mean[known]),
            covariance - gain @ covariance[known])


def _stacked_values(scans: Sequence[Reading]) -> np.ndarray:
    """(2 n,) float64 of all t, then all y, of n scans; NaN where not known."""
    return np.array([[s.log_gamma_counted, s.log_gamma_estimated] for s in scans]).T.ravel()
