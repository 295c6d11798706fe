# SPDX-License-Identifier: Apache-2.0
"""How good pictures are: how much of the depth is valid, how far it is, how much is sharp."""

from __future__ import annotations

from dataclasses import dataclass, field

import cv2
import numpy as np


@dataclass(frozen=True)
class PictureSettings:
    """Which pictures are looked at, and when a part of one is sharp.

    Attributes:
        every_ns: time between two pictures that are looked at, ns of their stamps. Chosen.
        tiles: number of tiles of a picture along each side. Chosen.
        scales_px: standard deviations of the two Gaussians between which edges are compared,
            pixels; the first against noise. Chosen.
        contrast: mean square gradient along an axis from which on a tile shows something, grey
            levels squared per pixel squared; ten times that of noise of two grey levels.
        edge_px: standard deviation of the widest edge that is sharp, pixels. Measured on
            bags/demo: its edges are 0 wide, and 1.2 to 1.7, 2.5 to 3.3 and 3.8 to 4.9 where its
            images are smoothed by 2, 3 and 5 pixels.
    """

    every_ns: int = 10**9
    tiles: int = 8
    scales_px: tuple[float, float] = (1.0, 2.0)
    contrast: float = 0.2
    edge_px: float = 2.0


SETTINGS = PictureSettings()


@dataclass(eq=False)
class PictureStatistics:
    """Figures of the pictures that were looked at.

    Attributes:
        valid: share of valid depth in each.
        distances: median of the valid depth of each, metres.
        ranges: 5% and 95% of the valid depth of each, metres.
        sharp: share that is sharp of what shows something, in each; of a blank one 0.
    """

    valid: list[float] = field(default_factory=list)
    distances: list[float] = field(default_factory=list)
    ranges: list[tuple[float, float]] = field(default_factory=list)
    sharp: list[float] = field(default_factory=list)

    def add_depth(self, depth: np.ndarray) -> None:
        """Takes (h, w) float32 metres, 0 where invalid."""
        valid = depth > 0
        self.valid.append(float(valid.mean()))
        if valid.any():
            near, middle, far = np.quantile(depth[valid], (0.05, 0.5, 0.95)).tolist()
            self.distances.append(middle)
            self.ranges.append((near, far))

    def add_color(self, color: np.ndarray) -> None:
        """Takes (h, w, 3) uint8 RGB."""
        widths = edge_widths(color)
        self.sharp.append(float(np.mean(widths <= SETTINGS.edge_px)) if len(widths) else 0.0)


def edge_widths(color: np.ndarray) -> np.ndarray:
    """How wide the edges are in each tile that shows something, in the more blurred direction.

    Smoothing by s pixels makes an edge of standard deviation w as wide as sqrt(w^2 + s^2), and
    its mean square gradient is inverse to that: the ratio at two scales gives w, whatever the
    contrast.

    Args:
        color: (h, w, 3) uint8 RGB.

    Returns:
        (n,) standard deviations, pixels.
    """
    grey = cv2.cvtColor(color, cv2.COLOR_RGB2GRAY).astype(np.float32)
    fine, coarse = SETTINGS.scales_px
    along_axes = []
    for dx, dy in ((1, 0), (0, 1)):
        before, after = (_tile_means(cv2.Sobel(cv2.GaussianBlur(grey, (0, 0), scale), cv2.CV_32F,
                                               dx, dy, scale=1 / 8) ** 2)
                         for scale in (fine, coarse))
        ratio = np.square(after / np.maximum(before, 1e-9))
        width = np.sqrt(np.maximum(ratio * coarse**2 - fine**2, 0)
                        / np.maximum(1 - ratio, 1e-6))
        along_axes.append(np.where(before >= SETTINGS.contrast, width, -1))
    widths = np.maximum(*along_axes)
    return widths[widths >= 0]


def _tile_means(image: np.ndarray) -> np.ndarray:
    """Means of the tiles of an (h, w) image: (tiles squared,)."""
    tiles = SETTINGS.tiles
    return cv2.resize(image, (tiles, tiles), interpolation=cv2.INTER_AREA).ravel()


def median(values: list[float]) -> float:
    """The median; nan of no values."""
    return float(np.median(values)) if values else float("nan")
