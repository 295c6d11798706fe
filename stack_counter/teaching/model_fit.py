"""A part's gamma from its simulated piles: two regressions, and what they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stack_counter.errors import PartError
from stack_counter.parts.gamma_model import FEATURES, GammaModel, fill_features
from stack_counter.teaching.simulated_piles import PileScan

_LEAST_PILES = 24  # of some eight numbers to find
# What all scans of a rig have in common of log V's error, by its container's walls and floor:
# covariance of the coefficients of 1 and 1 / (h + 1/2) on training rigs, seen from around and from
# one side (`python -m stack_counter.train.parts` prints them).
OF_THE_RIG = {"around": np.array([[0.00107, -0.00131], [-0.00131, 0.00319]]),
              "one side": np.array([[0.00541, -0.00852], [-0.00852, 0.01960]])}
# Variance of log gamma by the form of the container, which one rig has but one of. Chosen on six
# training rigs, by the error and the coverage after one and three counted bins.
_OF_THE_FORM = 0.001
_LEAST_OWN = 0.5  # of the noise of piles that the network does not hear, what is new in each scan
_FAR = 4.0  # median absolute deviations; farther off, the scan has missed its container


def fit_model(piles: Sequence[PileScan], seen: str = "around") -> GammaModel:
    """Fits the Gaussian of `part_model` to piles of known friction, `seen` as `OF_THE_RIG` says.

    What the scans of a rig share is the friction of its parts, uniform over the piles' range, how
    wrong its container is taken to be, and what the piles leave unknown of the coefficients.

    Raises:
        PartError: too few piles.
    """
    if len(piles) < _LEAST_PILES:
        raise PartError(f"{len(piles)} piles gave a scan; expected at least {_LEAST_PILES}")
    kept = _kept(*_arrays(piles))
    usual = [piles[i] for i in kept]
    models = [_fitted([p for p in usual if p is not left], seen) for left in usual]
    every = _fitted(usual, seen)
    scores = [_score(models[kept.index(i)] if i in kept else every, pile)
              for i, pile in enumerate(piles)]
    return replace(every, scores=np.sort(scores))


def left_out_error(piles: Sequence[PileScan], seen: str) -> float:
    """Mean squared error of log gamma, each pile by a model that has not seen it; those far off
    are left out."""
    usual = [piles[i] for i in _kept(*_arrays(piles))]
    misses = []
    for left in usual:
        model = _fitted([p for p in usual if p is not left], seen)
        misses.append(left.reading.log_gamma_counted
                      - model.posterior(replace(left.reading, log_gamma_counted=np.nan)).mean)
    return float(np.mean(np.square(misses)))


def _fitted(piles: Sequence[PileScan], seen: str) -> GammaModel:
    x, values = _arrays(piles)
    coefficients, noise, doubt = _regression(x, values)
    per_friction = coefficients[:, FEATURES]
    of_friction = np.zeros((2, FEATURES))
    of_friction[:, 0] = per_friction
    variance = np.ptp([p.friction for p in piles]) ** 2 / 12
    shared = np.kron(noise, doubt[:FEATURES, :FEATURES]) \
        + variance * np.outer(of_friction, of_friction)
    volume = float(np.mean([p.volume_std**2 for p in piles]))
    of_rig, common = OF_THE_RIG[seen] + np.diag([_OF_THE_FORM, 0.0]), x[:, :2]
    mean = float(np.mean(np.sum(common @ of_rig * common, axis=1)))
    unheard = noise[0, 0] - noise[0, 1] ** 2 / noise[1, 1]  # by the network, as V's error is
    share = min(1.0, (1 - _LEAST_OWN) * unheard / mean)
    shared[:2, :2] += share * of_rig
    noise = noise - np.diag([share * mean, 0.0])
    least = np.array([min(p.reading.height for p in piles), min(p.reading.width for p in piles)])
    return GammaModel(coefficients[:, :FEATURES], shared, noise, volume, np.zeros(1), least,
                      per_friction, "piles")


def _score(model: GammaModel, pile: PileScan) -> float:
    """The error of a pile that the model has not seen, in its standard deviations."""
    posterior = model.posterior(replace(pile.reading, log_gamma_counted=np.nan))
    error = pile.reading.log_gamma_counted - posterior.mean
    return float(error / np.hypot(posterior.std, pile.volume_std))


def _arrays(piles: Sequence[PileScan]) -> tuple[np.ndarray, np.ndarray]:
    """(n, FEATURES + 1) features, friction about the middle of its range last; (n, 2) t and y."""
    friction = np.array([p.friction for p in piles])
    x = fill_features(np.array([p.reading.height for p in piles]),
                      np.array([p.reading.width for p in piles]))
    middle = (friction.min() + friction.max()) / 2
    return (
        np.column_stack([x, friction - middle]),
        np.array([[p.reading.log_gamma_counted, p.reading.log_gamma_estimated] for p in piles]),
    )


def _regression(x: np.ndarray, values: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (2, k) of (n, 2) values on (n, k) features, the residuals' covariance (2, 2),
    and (k, k) what times that is the coefficients'."""
    doubt = np.linalg.inv(x.T @ x + 1e-4 * np.eye(x.shape[1]))
    coefficients = (doubt @ x.T @ values).T
    left = values - x @ coefficients.T
    return coefficients, left.T @ left / (len(x) - x.shape[1]), doubt


def _kept(x: np.ndarray, values: np.ndarray) -> list[int]:
    """Indices of the piles that a regression does not find far off."""
    kept = np.arange(len(x))
    for _ in range(3):
        coefficients, _, _ = _regression(x[kept], values[kept])
        left = values[:, 0] - x @ coefficients[0]
        kept = np.flatnonzero(np.abs(left) < _FAR * 1.4826 * np.median(np.abs(left[kept])))
    return kept.tolist()
