# SPDX-License-Identifier: Apache-2.0
"""The paper's metrics, exactly (supplement, "Metrics"), of (n,) true values y and guesses y'."""

from __future__ import annotations

import math

import numpy as np


def nae(true: np.ndarray, guess: np.ndarray) -> float:
    """Normalised absolute error: sum |y - y'| / sum y."""
    return float(np.abs(true - guess).sum() / true.sum())


def sre(true: np.ndarray, guess: np.ndarray) -> float:
    """Squared relative error: sum (y - y')^2 / sum y^2."""
    return float(((true - guess) ** 2).sum() / (true**2).sum())


def mae(true: np.ndarray, guess: np.ndarray) -> float:
    """Mean absolute error."""
    return float(np.abs(true - guess).mean())


def rmse(true: np.ndarray, guess: np.ndarray) -> float:
    """Root mean squared error."""
    return float(np.sqrt(((true - guess) ** 2).mean()))


def smape(true: np.ndarray, guess: np.ndarray) -> float:
    """Symmetric mean absolute percentage error, percent: mean |y - y'| / ((y + y') / 2)."""
    return float(100 * np.mean(np.abs(true - guess) / ((true + guess) / 2)))


def r2(true: np.ndarray, guess: np.ndarray) -> float:
    """Coefficient of determination: 1 - sum (y - y')^2 / sum (y - mean y)^2."""
    return float(1 - ((true - guess) ** 2).sum() / ((true - true.mean()) ** 2).sum())


def wilson_interval(hits: int, total: int, z: float = 1.96) -> tuple[float, float]:
    """95% confidence interval of the share hits / total; `z` in standard deviations.

    Source: Wilson, "Probable Inference, the Law of Succession, and Statistical Inference" (1927).
    """
    share, extra = hits / total, z**2 / total
    middle = (share + extra / 2) / (1 + extra)
    half = z / (1 + extra) * math.sqrt(share * (1 - share) / total + extra / (4 * total))
    return middle - half, middle + half
