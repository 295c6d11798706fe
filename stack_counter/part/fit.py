"""A part's gamma from its simulated piles: two regressions, and what they leave."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from stack_counter.errors import PartError
from stack_counter.part.piles import Seen
from stack_counter.part_model import FEATURES, GammaModel, features

_LEAST_PILES = 24  # of some eight numbers to find
# Of the variance of V's error, what all scans of a rig have in common, by its container's walls
# and floor: on training rigs 0.024 of 0.034 (`python -m stack_counter.train.parts` prints them).
_OF_THE_RIG = 0.5
_FAR = 4.0  # median absolute deviations; farther off, the scan has missed its container


def fit_model(piles: Sequence[Seen], source: str = "piles") -> GammaModel:
    """Fits the Gaussian of `part_model` to piles of known friction.

    What the scans of a rig share is the friction of its parts, uniform over the piles' range, how
    wrong its container is taken to be, and what the piles leave unknown of the coefficients.

    Raises:
        PartError: too few piles.
    """
    if len(piles) < _LEAST_PILES:
        raise PartError(f"{len(piles)} piles gave a scan; expected at least {_LEAST_PILES}")
    kept = _kept(*_arrays(piles))
    usual = [piles[i] for i in kept]
    models = [_fitted([p for p in usual if p is not left], source) for left in usual]
    every = _fitted(usual, source)
    scores = [_score(models[kept.index(i)] if i in kept else every, pile)
              for i, pile in enumerate(piles)]
    return replace(every, scores=np.sort(scores))


def left_out_error(piles: Sequence[Seen]) -> float:
    """Mean squared error of log gamma, each pile by a model that has not seen it; those far off
    are left out."""
    usual = [piles[i] for i in _kept(*_arrays(piles))]
    misses = []
    for left in usual:
        model = _fitted([p for p in usual if p is not left], "piles")
        misses.append(left.reading.true
                      - model.believe(replace(left.reading, true=np.nan)).mean)
    return float(np.mean(np.square(misses)))


def _fitted(piles: Sequence[Seen], source: str) -> GammaModel:
    x, values = _arrays(piles)
    coefficients, noise, doubt = _regression(x, values)
    per_friction = coefficients[:, FEATURES]
    of_friction = np.zeros((2, FEATURES))
    of_friction[:, 0] = per_friction
    variance = np.ptp([p.friction for p in piles]) ** 2 / 12
    shared = np.kron(noise, doubt[:FEATURES, :FEATURES]) \
        + variance * np.outer(of_friction, of_friction)
    volume = float(np.mean([p.volume_std**2 for p in piles]))
    of_container = min(_OF_THE_RIG * volume, noise[0, 0] / 2)
    shared[0, 0] += of_container
    noise = noise - np.diag([of_container, 0.0])
    least = np.array([min(p.reading.height for p in piles), min(p.reading.width for p in piles)])
    return GammaModel(coefficients[:, :FEATURES], shared, noise, volume, np.zeros(1), least,
                      per_friction, source)


def _score(model: GammaModel, pile: Seen) -> float:
    """The error of a pile that the model has not seen, in its standard deviations."""
    belief = model.believe(replace(pile.reading, true=np.nan))
    return float((pile.reading.true - belief.mean) / np.hypot(belief.std, pile.volume_std))


def _arrays(piles: Sequence[Seen]) -> tuple[np.ndarray, np.ndarray]:
    """(n, FEATURES + 1) features, friction about the middle of its range last; (n, 2) t and y."""
    friction = np.array([p.friction for p in piles])
    x = features(np.array([p.reading.height for p in piles]),
                 np.array([p.reading.width for p in piles]))
    middle = (friction.min() + friction.max()) / 2
    return (np.column_stack([x, friction - middle]),
            np.array([[p.reading.true, p.reading.said] for p in piles]))


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
