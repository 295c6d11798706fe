# SPDX-License-Identifier: Apache-2.0
"""The network's last layers, adapted to one part's piles: `stack-counter part add --tune`."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from stack_counter.teaching.model_fit import left_out_error
from stack_counter.teaching.simulated_piles import Pile, PileScan

# Penalties of the ridge regression to choose from, in mean squares of the features; chosen.
_PENALTIES = np.logspace(-3, 2, 11)


@dataclass(frozen=True, eq=False)
class Tuning:
    """Changes of the last layers, and what they are worth.

    Attributes:
        weight: (members, h) changes of the last layers' weights.
        bias: change of their biases.
        piles: the piles as the changed network reads them, each by one fitted without it.
        joined, tuned: mean squared errors of log gamma on piles left out, scans from around and
            from one side alike, before and after tuning.
        better: tuning is better for both kinds of scans.
    """

    weight: np.ndarray
    bias: float
    piles: list[Pile]
    joined: float
    tuned: float
    better: bool


def tune(piles: list[Pile]) -> Tuning:
    """Fits the network's errors by ridge regression, anchored at the network as it is.

    Args:
        piles: piles of a request that keeps what the last layers read.
    """
    usable = [pile for pile in piles if pile.arc is not None]
    arcs = [pile.arc for pile in usable if pile.arc is not None]
    # Errors of log gamma on the inputs of the last layers
    inputs = np.array([_last_layer_input(arc) for arc in arcs])  # (n, members * h)
    errors = np.array([arc.reading.log_gamma_counted - arc.reading.log_gamma_estimated
                       for arc in arcs])
    penalty = min(_PENALTIES, key=lambda p: float((_left_out_errors(inputs, errors, p)**2).sum()))
    # Every pile by a network fitted without it
    changed = []
    for i, pile in enumerate(usable):
        others = np.arange(len(usable)) != i
        weight, bias = _fit_ridge(inputs[others], errors[others], penalty)
        changed.append(Pile(*(_apply_change(scan, weight, bias)
                              for scan in (pile.arc, pile.above))))
    weight, bias = _fit_ridge(inputs, errors, penalty)
    # The network's estimate is the mean of its members: each one changes by the whole.
    first = arcs[0].last_layer_input
    shape = first.shape if first is not None else (1, -1)
    before, after = _errors_by_kind(usable), _errors_by_kind(changed)
    return Tuning(weight.reshape(shape) * shape[0], bias, changed, float(before.mean()),
                  float(after.mean()), bool((after < before).all()))


def _errors_by_kind(piles: list[Pile]) -> np.ndarray:
    """Mean squared error of each kind of scans that there are: from around, from one side."""
    kinds = (("around", [p.arc for p in piles if p.arc]),
             ("one side", [p.above for p in piles if p.above]))
    return np.array([left_out_error(scans, kind) for kind, scans in kinds if scans])


def _last_layer_input(scan: PileScan) -> np.ndarray:
    """(members * h,) inputs of the last layers."""
    assert scan.last_layer_input is not None  # piles of a request that keeps it
    return scan.last_layer_input.ravel()


def _fit_ridge(inputs: np.ndarray, errors: np.ndarray, penalty: float
               ) -> tuple[np.ndarray, float]:
    """Weights (k,) and bias that give (n,) errors from (n, k) inputs; the bias is free."""
    center, mean = inputs.mean(axis=0), float(errors.mean())
    kernel = (inputs - center) @ (inputs - center).T
    kernel += penalty * np.trace(kernel) / len(inputs) * np.eye(len(inputs))
    weight = (inputs - center).T @ np.linalg.solve(kernel, errors - mean)
    return weight, mean - float(center @ weight)


def _left_out_errors(inputs: np.ndarray, errors: np.ndarray, penalty: float) -> np.ndarray:
    """(n,) remaining errors, each of a regression without that pile."""
    remaining = []
    for i in range(len(inputs)):
        others = np.arange(len(inputs)) != i
        weight, bias = _fit_ridge(inputs[others], errors[others], penalty)
        remaining.append(errors[i] - inputs[i] @ weight - bias)
    return np.array(remaining)


def _apply_change(scan: PileScan | None, weight: np.ndarray, bias: float) -> PileScan | None:
    """The scan as a network with changed last layers reads it."""
    if scan is None or scan.last_layer_input is None:
        return None
    estimated = scan.reading.log_gamma_estimated \
        + float(scan.last_layer_input.ravel() @ weight) + bias
    return replace(scan, reading=replace(scan.reading, log_gamma_estimated=estimated))
