# SPDX-License-Identifier: Apache-2.0
"""Class models that learn while they label: histograms of what a pixel looks like.

Histograms rather than Gaussian mixtures: they take soft labels, and views are added one by one.
The hue of a pixel is kept apart from its brightness, as log ratios of its channels: shadow and
shading, which change from view to view, leave these nearly alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

CLASSES = 3  # background, container, parts: the values of a label image
NEVER = 1e-9  # probability of what is ruled out
_DARK = 4.0  # grey levels added before the logarithm: below, ratios are noise
_BLUR = 0.5  # standard deviation, pixels, against noise of single pixels
_HUE_RANGE = 1.0  # largest log ratio told apart
_SIDE = 12.0  # standard deviation of colour inside a surface, grey levels
_TIE, _TIE_ACROSS = 1.5, 0.1  # pull of a neighbour inside a surface, and its share across an edge
_ROUNDS = 3  # of `smoothed`


@dataclass(frozen=True)
class Channel:
    """A histogram's axes.

    Attributes:
        shape: bins along each axis.
        blur: standard deviation, bins, along each axis.
        weight: of its log likelihood; below 1 for what does not tell classes apart by itself.
    """

    shape: tuple[int, ...]
    blur: tuple[float, ...]
    weight: float

    def bins(self, *shares: np.ndarray) -> np.ndarray:
        """(h, w) int32 bin numbers of values from 0 to 1 along each axis."""
        number = np.zeros(shares[0].shape, np.int32)
        for share, size in zip(shares, self.shape):
            number = number * size + np.clip(share * size, 0, size - 1).astype(np.int32)
        return number


_HUE = Channel((32, 32), (1.0, 1.0), 1.0)
_BRIGHTNESS = Channel((24,), (2.0,), 0.25)
_CHANNELS = (_HUE, _BRIGHTNESS)


def color_bins(color: np.ndarray) -> list[np.ndarray]:
    """(h, w) int32 bins of hue, and of brightness, of an (h, w, 3) uint8 RGB image."""
    calm = cv2.GaussianBlur(color, (0, 0), _BLUR).astype(np.float32)
    red, green, blue = np.log(np.moveaxis(calm, -1, 0) + _DARK)
    low, high = np.log(_DARK), np.log(255 + _DARK)
    return [_HUE.bins((red - green) / (2 * _HUE_RANGE) + 0.5,
                      (blue - green) / (2 * _HUE_RANGE) + 0.5),
            _BRIGHTNESS.bins(((red + green + blue) / 3 - low) / (high - low))]


class ColorModels:
    """How often each class had a pixel's bins in what was labelled so far."""

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forgets what was learnt."""
        self._counts = [np.zeros((CLASSES, int(np.prod(c.shape)))) for c in _CHANNELS]

    def add(self, bins: list[np.ndarray], weights: np.ndarray) -> None:
        """Learns from one image.

        Args:
            bins: as `color_bins` gives them.
            weights: (3, h, w) float, of each class.
        """
        for counts, numbers in zip(self._counts, bins):
            for row, weight in zip(counts, weights):
                row += np.bincount(numbers.ravel(), weight.ravel(), len(row))

    def log(self, bins: list[np.ndarray]) -> np.ndarray:
        """(3, h, w) float32 log likelihoods, up to a constant of each pixel."""
        total = np.zeros((CLASSES, *bins[0].shape), np.float32)
        for channel, counts, numbers in zip(_CHANNELS, self._counts, bins):
            for k, row in enumerate(counts):
                smooth = ndimage.gaussian_filter(row.reshape(channel.shape), channel.blur,
                                                 mode="constant").ravel()
                share = smooth / max(smooth.sum(), 1e-9)
                # What no class has shown tells nothing: all get the same floor.
                table = channel.weight * np.log(share + 0.1 / len(row))
                total[k] += table[numbers]
        return total


def posterior(log_odds: np.ndarray) -> np.ndarray:
    """(3, h, w) float32 probabilities that sum to 1, from logarithms up to a constant."""
    p = np.exp(log_odds - log_odds.max(axis=0))
    return p / p.sum(axis=0)


def smoothed(log_odds: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Labels that agree with their neighbours, except across edges of the colour image.

    Mean-field rounds of a Potts model on the grid of pixels.

    Source: Kraehenbuehl and Koltun, "Efficient Inference in Fully Connected CRFs with Gaussian
    Edge Potentials" (2011), equation 3, with the four neighbours only.

    Args:
        log_odds: (3, h, w) float32, prior times likelihood.
        color: (h, w, 3) uint8 RGB.

    Returns:
        (3, h, w) float32 probabilities.
    """
    image = color.astype(np.float32)

    def ties(step: np.ndarray) -> np.ndarray:
        alike = np.exp(-np.sum(step**2, axis=-1) / (6 * _SIDE**2))
        return _TIE * (_TIE_ACROSS + (1 - _TIE_ACROSS) * alike)

    across, down = ties(np.diff(image, axis=1)), ties(np.diff(image, axis=0))
    p = posterior(log_odds)
    for _ in range(_ROUNDS):
        pull = np.zeros_like(p)
        pull[:, :, 1:] += across * p[:, :, :-1]
        pull[:, :, :-1] += across * p[:, :, 1:]
        pull[:, 1:] += down * p[:, :-1]
        pull[:, :-1] += down * p[:, 1:]
        p = posterior(log_odds + pull)
    return p
