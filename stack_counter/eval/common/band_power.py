# SPDX-License-Identifier: Apache-2.0
"""The power spectrum of a height map in octaves, beside that of the true one."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

# Wavelengths between the octaves, part lengths: coarse to fine.
EDGES = (4.0, 2.0, 1.0, 0.5, 0.25)
# Standard deviation, in wavelengths, of the Gaussian that halves a wave of that length.
_HALVING_STD = float(np.sqrt(np.log(2) / 2) / np.pi)


@dataclass(frozen=True)
class BandPower:
    """Heights whose waves are between two lengths.

    Attributes:
        true, measured: mean square of the true and of the measured heights, m2.
        kept: share of the true waves' amplitude that the measured heights have: the slope of
            their regression on the true ones; 1 for a perfect surface, noise does not add to it.
    """

    true: float
    measured: float
    kept: float


def band_powers(measured: np.ndarray, true: np.ndarray, pitch: float, part_length: float
                ) -> list[BandPower]:
    """Compares two height maps octave by octave, where both are known.

    Args:
        measured, true: (rows, cols) metres, NaN where unknown.
        pitch: side of a cell, metres.
        part_length: cube root of the part's volume, metres.

    Returns:
        One for each octave between `EDGES`.
    """
    known = (np.isfinite(measured) & np.isfinite(true)).astype(np.float32)
    stds = [_HALVING_STD * edge * part_length / pitch for edge in EDGES]
    levels = [[_smooth(np.where(known > 0, heights, 0), known, std) for std in stds]
              for heights in (measured, true)]
    # Leave out what the widest Gaussian reaches over the edge of the map.
    inside = known > 0
    powers = []
    for k in range(len(stds) - 1):
        here, there = ((level[k + 1] - level[k])[inside].astype(float) for level in levels)
        powers.append(BandPower(float(np.mean(there**2)), float(np.mean(here**2)),
                                float(np.mean(here * there) / max(np.mean(there**2), 1e-30))))
    return powers


def _smooth(heights: np.ndarray, known: np.ndarray, std: float) -> np.ndarray:
    """Returns the (rows, cols) heights smoothed by a Gaussian over the known cells."""
    weight = cv2.GaussianBlur(known, (0, 0), std, borderType=cv2.BORDER_CONSTANT)
    total = cv2.GaussianBlur(heights.astype(np.float32), (0, 0), std,
                             borderType=cv2.BORDER_CONSTANT)
    return total / np.maximum(weight, 1e-6)
