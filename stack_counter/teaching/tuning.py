"""The network's last layers, adapted to one part's piles: `stack-counter part add --tune`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter.teaching.model_fit import left_out_error
from stack_counter.teaching.simulated_piles import Pile, PileScan

_PENALTIES = np.logspace(-3, 2, 11)  # of the ridge, in mean squares of what is read


@dataclass(frozen=True)
class Tuning:
    """Changes of the last layers, the piles as the changed network sees them (each by one that
    has not seen it), and the mean squared errors of log gamma on piles left out, scans from around
    and from one side alike: joined as they were, and joined after tuning; `better`: for both."""

    weight: np.ndarray
    bias: float
    piles: list[Pile]
    joined: float
    tuned: float
    better: bool


def tune(piles: list[Pile]) -> Tuning:
    """Ridge regression of what the network misses, anchored at the network as it is.

    Args:
        piles: of an order with `tune`.
    """
    usable = [pile for pile in piles if pile.arc is not None]
    z = np.array([_read(pile.arc) for pile in usable])
    misses = np.array([pile.arc.reading.log_gamma_counted - pile.arc.reading.log_gamma_estimated
                       for pile in usable if pile.arc is not None])
    penalty = min(_PENALTIES, key=lambda p: float((_left_out(z, misses, p) ** 2).sum()))
    changed = []
    for i, pile in enumerate(usable):
        others = np.arange(len(usable)) != i
        weight, bias = _ridge(z[others], misses[others], penalty)
        changed.append(Pile(*(_shifted(seen, weight, bias) for seen in (pile.arc, pile.above))))
    weight, bias = _ridge(z, misses, penalty)
    members = usable[0].arc.hidden.shape if usable[0].arc is not None and \
        usable[0].arc.hidden is not None else (1, -1)
    # The network says the mean of its members: each one changes by the whole.
    before, after = _errors(usable), _errors(changed)
    return Tuning(weight.reshape(members) * members[0], bias, changed, float(before.mean()),
                  float(after.mean()), bool((after < before).all()))


def _errors(piles: list[Pile]) -> np.ndarray:
    """Mean squared error of each kind of scans that there are: from around, from one side."""
    kinds = (("around", [p.arc for p in piles if p.arc]),
             ("one side", [p.above for p in piles if p.above]))
    return np.array([left_out_error(seen, kind) for kind, seen in kinds if seen])


def _read(seen: PileScan | None) -> np.ndarray:
    assert seen is not None and seen.hidden is not None  # piles of an order with `tune`
    return seen.hidden.ravel()


def _ridge(z: np.ndarray, misses: np.ndarray, penalty: float) -> tuple[np.ndarray, float]:
    """Weights (k,) and bias that give (n,) misses from (n, k) features; the bias is free."""
    middle, mean = z.mean(axis=0), float(misses.mean())
    kernel = (z - middle) @ (z - middle).T
    kernel += penalty * np.trace(kernel) / len(z) * np.eye(len(z))
    weight = (z - middle).T @ np.linalg.solve(kernel, misses - mean)
    return weight, mean - float(middle @ weight)


def _left_out(z: np.ndarray, misses: np.ndarray, penalty: float) -> np.ndarray:
    """(n,) errors, each of a regression without that pile."""
    out = []
    for i in range(len(z)):
        others = np.arange(len(z)) != i
        weight, bias = _ridge(z[others], misses[others], penalty)
        out.append(misses[i] - z[i] @ weight - bias)
    return np.array(out)


def _shifted(seen: PileScan | None, weight: np.ndarray, bias: float) -> PileScan | None:
    if seen is None or seen.hidden is None:
        return None
    shifted = seen.reading.log_gamma_estimated + float(seen.hidden.ravel() @ weight) + bias
    return replace(seen, reading=replace(seen.reading, log_gamma_estimated=shifted))
