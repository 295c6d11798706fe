# SPDX-License-Identifier: Apache-2.0
"""How good pictures are: how much of the depth is valid, how far it is, how much is sharp."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np


@dataclass(frozen=True)
class PictureSettings:
    """Which pictures are looked at, and how; all are chosen.

    Attributes:
        every_ns: time between two pictures that are looked at, ns of their stamps.
        tiles: number of tiles of a picture along each side.
    """

    every_ns: int = 10**9
    tiles: int = 8


SETTINGS = PictureSettings()


@dataclass(eq=False)
class PictureStatistics:
    """Figures of the pictures that were looked at.

    Attributes:
        valid: share of valid depth in each.
        distances: median of the valid depth of each, metres.
        sharp: share of sharp tiles in each.
        sharpness: variance of the Laplacian of each as a whole, grey levels squared.
    """

    valid: list[float] = field(default_factory=list)
    distances: list[float] = field(default_factory=list)
    sharp: list[float] = field(default_factory=list)
    sharpness: list[float] = field(default_factory=list)

    def add_depth(self, depth: np.ndarray) -> None:
        """Takes (h, w) float32 metres, 0 where invalid."""
        valid = depth > 0
        self.valid.append(float(valid.mean()))
        if valid.any():
            self.distances.append(float(np.median(depth[valid])))

    def add_color(self, color: np.ndarray, min_sharpness: float) -> None:
        """Takes (h, w, 3) uint8 RGB; `min_sharpness` is the collector's."""
        grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY)
        edges = cv2.Laplacian(grey, cv2.CV_32F)
        self.sharpness.append(float(edges.var()))
        tiles = [tile for rows in np.array_split(edges, SETTINGS.tiles)
                 for tile in np.array_split(rows, SETTINGS.tiles, axis=1) if tile.size]
        self.sharp.append(float(np.mean([tile.var() >= min_sharpness for tile in tiles])))


def median(values: list[float]) -> float:
    """The median; nan of no values."""
    return float(np.median(values)) if values else float("nan")
