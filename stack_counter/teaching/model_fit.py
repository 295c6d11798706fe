# SPDX-License-Identifier: Apache-2.0
"""A part's gamma from its simulated piles: two regressions, and what they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from stack_counter.errors import PartError
from stack_counter.parts.gamma_model import FEATURES, GammaModel, fill_features
from stack_counter.teaching.simulated_piles import PileScan

# What all scans of a rig have in common of log V's error, by its container's walls and floor:
# covariance of the coefficients of 1 and 1 / (h + 1/2) on training rigs, seen from around and from
# one side (`python -m stack_counter.train.parts` prints them).
RIG_COVARIANCES = {"around": np.array([[0.00107, -0.00131], [-0.00131, 0.00319]]),
                   "one side": np.array([[0.00541, -0.00852], [-0.00852, 0.01960]])}


@dataclass(frozen=True)
class ModelFitSettings:
    """How a part's model is fitted.

    Attributes:
        min_piles: fewest piles, for some eight numbers to find; chosen.
        container_variance: variance of log gamma by the form of the container, which one rig has
            but one of. Chosen on six training rigs, by the error and the coverage after one and
            three counted bins.
        min_own_share: least share that is new in each scan, of the piles' noise that the network
            does not explain; chosen.
        max_deviation: a pile is an outlier, whose scan has missed its container, beyond so many
            standard deviations by the median absolute deviation; chosen.
        outlier_rounds: rounds in which outliers are found; chosen.
        ridge: added to the diagonal of the features' products; chosen.
    """

    min_piles: int = 24
    container_variance: float = 0.001
    min_own_share: float = 0.5
    max_deviation: float = 4.0
    outlier_rounds: int = 3
    ridge: float = 1e-4


SETTINGS = ModelFitSettings()
# Standard deviation of a Gaussian over its median absolute deviation.
_MAD_TO_STD = 1.4826


@dataclass(frozen=True, eq=False)
class _Regression:
    """A linear regression of log gamma, counted and estimated, on k features.

    Attributes:
        coefficients: (2, k).
        noise: (2, 2) covariance of the residuals.
        inverse: (k, k); times a residual variance, the covariance of the coefficients.
    """

    coefficients: np.ndarray
    noise: np.ndarray
    inverse: np.ndarray


def fit_model(piles: Sequence[PileScan], viewpoint: str = "around") -> GammaModel:
    """Fits the Gaussian of `gamma_model` to piles of known friction.

    What the scans of a rig share is the friction of its parts, spread as that of the piles, how
    wrong its container is taken to be, and what the piles leave unknown of the coefficients.

    Args:
        piles: scans of simulated piles.
        viewpoint: from where they were scanned, a key of `RIG_COVARIANCES`.

    Raises:
        PartError: too few piles.
    """
    if len(piles) < SETTINGS.min_piles:
        raise PartError(f"{len(piles)} piles gave a scan; expected at least {SETTINGS.min_piles}")
    # One model of all piles but outliers, and one without each
    kept = _find_inliers(*_regression_data(piles))
    inliers = [piles[i] for i in kept]
    without_one = [_fit_gaussian([p for p in inliers if p is not left_out], viewpoint)
                   for left_out in inliers]
    model = _fit_gaussian(inliers, viewpoint)
    # Conformal scores of all piles, each by a model that was fitted without it
    scores = [_conformal_score(without_one[kept.index(i)] if i in kept else model, pile)
              for i, pile in enumerate(piles)]
    return replace(model, scores=np.sort(scores))


def left_out_error(piles: Sequence[PileScan], viewpoint: str) -> float:
    """Mean squared error of log gamma, each pile by a model fitted without it.

    Outliers are left out.
    """
    inliers = [piles[i] for i in _find_inliers(*_regression_data(piles))]
    errors = []
    for left_out in inliers:
        model = _fit_gaussian([p for p in inliers if p is not left_out], viewpoint)
        uncounted = replace(left_out.reading, log_gamma_counted=np.nan)
        errors.append(left_out.reading.log_gamma_counted - model.posterior(uncounted).mean)
    return float(np.mean(np.square(errors)))


def _fit_gaussian(piles: Sequence[PileScan], viewpoint: str) -> GammaModel:
    """The model of piles, without its scores."""
    features, values = _regression_data(piles)
    fit = _fit_regression(features, values)
    # Shared by a rig's scans: uncertain coefficients, and friction, as the piles'
    per_friction = fit.coefficients[:, FEATURES]
    friction_direction = np.zeros((2, FEATURES))
    friction_direction[:, 0] = per_friction
    friction_variance = np.var([p.friction for p in piles])
    shared = np.kron(fit.noise, fit.inverse[:FEATURES, :FEATURES]) \
        + friction_variance * np.outer(friction_direction, friction_direction)
    # Shared too: V's error by the container, as far as the noise allows that the network does not
    # explain; it is taken from the noise of the single scan
    rig_covariance = RIG_COVARIANCES[viewpoint] + np.diag([SETTINGS.container_variance, 0.0])
    common = features[:, :2]
    mean = float(np.mean(np.sum(common @ rig_covariance * common, axis=1)))
    unexplained = fit.noise[0, 0] - fit.noise[0, 1] ** 2 / fit.noise[1, 1]
    share = min(1.0, (1 - SETTINGS.min_own_share) * unexplained / mean)
    shared[:2, :2] += share * rig_covariance
    return GammaModel(
        coefficients=fit.coefficients[:, :FEATURES], shared=shared,
        noise=fit.noise - np.diag([share * mean, 0.0]),
        volume_variance=float(np.mean([p.volume_std**2 for p in piles])), scores=np.zeros(1),
        least=np.array([min(p.reading.height for p in piles),
                        min(p.reading.width for p in piles)]),
        friction=per_friction, source="piles")


def _conformal_score(model: GammaModel, pile: PileScan) -> float:
    """The error of a pile that the model was fitted without, in its standard deviations."""
    posterior = model.posterior(replace(pile.reading, log_gamma_counted=np.nan))
    error = pile.reading.log_gamma_counted - posterior.mean
    return float(error / np.hypot(posterior.std, pile.volume_std))


def _regression_data(piles: Sequence[PileScan]) -> tuple[np.ndarray, np.ndarray]:
    """(n, FEATURES + 1) features, friction about its mean last.

    (n, 2) log gamma, counted and estimated.
    """
    friction = np.array([p.friction for p in piles])
    features = fill_features(np.array([p.reading.height for p in piles]),
                             np.array([p.reading.width for p in piles]))
    return (
        np.column_stack([features, friction - friction.mean()]),
        np.array([[p.reading.log_gamma_counted, p.reading.log_gamma_estimated] for p in piles]),
    )


def _fit_regression(features: np.ndarray, values: np.ndarray) -> _Regression:
    """Fits (n, 2) values on (n, k) features."""
    inverse = np.linalg.inv(features.T @ features + SETTINGS.ridge * np.eye(features.shape[1]))
    coefficients = (inverse @ features.T @ values).T
    residuals = values - features @ coefficients.T
    noise = residuals.T @ residuals / (len(features) - features.shape[1])
    return _Regression(coefficients, noise, inverse)


def _find_inliers(features: np.ndarray, values: np.ndarray) -> list[int]:
    """Indices of the piles that a regression of the counted log gamma does not find far off."""
    inliers = np.arange(len(features))
    for _ in range(SETTINGS.outlier_rounds):
        fit = _fit_regression(features[inliers], values[inliers])
        residuals = values[:, 0] - features @ fit.coefficients[0]
        median = np.median(np.abs(residuals[inliers]))
        limit = SETTINGS.max_deviation * _MAD_TO_STD * median
        inliers = np.flatnonzero(np.abs(residuals) < limit)
    return inliers.tolist()
