# SPDX-License-Identifier: Apache-2.0
"""Islands of depth that stand apart from all around them: they are wrong."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np


@dataclass(frozen=True)
class SpeckleSettings:
    """What an island is; all chosen.

    Attributes:
        levels: steps between two planes in which islands are told apart.
        min_px: smallest island that is kept, pixels.
        pixels_per_px: the same for large pictures: one pixel for so many of the picture.
    """

    levels: int = 16
    min_px: int = 20
    pixels_per_px: int = 5000


SETTINGS = SpeckleSettings()


def remove_speckles(position: np.ndarray) -> np.ndarray:
    """Smooths positions among the planes, and removes small islands that stand apart.

    Args:
        position: (h, w) float32, -1 where unknown.

    Returns:
        (h, w) float32, -1 where unknown or removed.
    """
    levels = SETTINGS.levels
    smooth = cv2.medianBlur(position.astype(np.float32), 3)
    position = np.where((position >= 0) & (smooth >= 0), smooth, -1)
    steps = np.round(position * levels).astype(np.int16)
    smallest = max(SETTINGS.min_px, position.size // SETTINGS.pixels_per_px)
    cv2.filterSpeckles(steps, -levels, smallest, 2 * levels)
    return np.where(steps >= 0, position, -1)
