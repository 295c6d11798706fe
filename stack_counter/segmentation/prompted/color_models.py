# SPDX-License-Identifier: Apache-2.0
"""Colour models of the classes, learnt while labelling: histograms of pixel colours.

Histograms rather than Gaussian mixtures: they take soft labels, and views are added one by one.
The hue of a pixel is kept apart from its brightness, as log ratios of its channels: shadow and
shading, which change from view to view, leave these nearly alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from scipy import ndimage

# Number of classes: background, container, parts, by their values in a label image.
NUM_CLASSES = 3
# Probability of a class that is ruled out; above 0, so that its logarithm is finite.
RULED_OUT = 1e-9


@dataclass(frozen=True)
class HistogramAxes:
    """Bins of a colour histogram.

    Attributes:
        shape: number of bins along each axis.
        blur: standard deviation of the Gaussian that smooths the histogram, bins, along each
            axis.
        weight: factor of the log likelihood; below 1 for a property that does not tell classes
            apart by itself.
    """

    shape: tuple[int, ...]
    blur: tuple[float, ...]
    weight: float

    def find_bins(self, *values: np.ndarray) -> np.ndarray:
        """Returns (h, w) int32 bin numbers of pixels.

        Args:
            *values: (h, w) float from 0 to 1, one array for each axis.
        """
        number = np.zeros(values[0].shape, np.int32)
        for value, size in zip(values, self.shape):
            number = number * size + np.clip(value * size, 0, size - 1).astype(np.int32)
        return number


@dataclass(frozen=True)
class ColorModelSettings:
    """How colours are counted, and how labels are smoothed; all chosen.

    Attributes:
        hue: histogram of the log ratios red to green and blue to green.
        brightness: histogram of the mean logarithm of the channels.
        log_offset: grey levels added before the logarithm; ratios of darker colours are noise.
        image_blur_px: standard deviation of the Gaussian against noise of single pixels, pixels.
        max_log_ratio: largest log ratio of two channels that the bins of hue tell apart.
        floor_share: probability added to every bin, over that of a uniform histogram; bins that
            no class has filled then favour no class.
        edge_scale: standard deviation of a channel inside a surface, grey levels.
        neighbor_weight: log odds that a neighbour of equal colour adds to its own label.
        edge_weight_share: share of `neighbor_weight` that is left across an edge.
        smoothing_rounds: number of mean-field rounds.
    """

    hue: HistogramAxes = HistogramAxes((32, 32), (1.0, 1.0), 1.0)
    brightness: HistogramAxes = HistogramAxes((24,), (2.0,), 0.25)
    log_offset: float = 4.0
    image_blur_px: float = 0.5
    max_log_ratio: float = 1.0
    floor_share: float = 0.1
    edge_scale: float = 12.0
    neighbor_weight: float = 1.5
    edge_weight_share: float = 0.1
    smoothing_rounds: int = 3


SETTINGS = ColorModelSettings()


def compute_color_bins(color: np.ndarray) -> list[np.ndarray]:
    """Returns the (h, w) int32 bins of hue, and of brightness, of an (h, w, 3) uint8 RGB image."""
    blurred = cv2.GaussianBlur(color, (0, 0), SETTINGS.image_blur_px).astype(np.float32)
    offset, max_ratio = SETTINGS.log_offset, SETTINGS.max_log_ratio
    red, green, blue = np.log(np.moveaxis(blurred, -1, 0) + offset)
    low, high = np.log(offset), np.log(255 + offset)
    hue = SETTINGS.hue.find_bins((red - green) / (2 * max_ratio) + 0.5,
                                 (blue - green) / (2 * max_ratio) + 0.5)
    brightness = SETTINGS.brightness.find_bins(((red + green + blue) / 3 - low) / (high - low))
    return [hue, brightness]


class ColorModels:
    """Histograms of hue and brightness of each class, over the images labelled so far."""

    def __init__(self) -> None:
        """Makes empty histograms."""
        self._axes = (SETTINGS.hue, SETTINGS.brightness)
        self.reset()

    def reset(self) -> None:
        """Empties the histograms."""
        self._counts = [np.zeros((NUM_CLASSES, int(np.prod(axes.shape)))) for axes in self._axes]

    def add_image(self, color_bins: list[np.ndarray], weights: np.ndarray) -> None:
        """Adds the pixels of one image to the histograms.

        Args:
            color_bins: the image's `compute_color_bins`.
            weights: (3, h, w) float, how much a pixel counts in each class.
        """
        for class_counts, bins in zip(self._counts, color_bins):
            for counts, weight in zip(class_counts, weights):
                counts += np.bincount(bins.ravel(), weight.ravel(), len(counts))

    def log_likelihood(self, color_bins: list[np.ndarray]) -> np.ndarray:
        """Returns (3, h, w) float32 log likelihoods, up to a constant of each pixel.

        Args:
            color_bins: the image's `compute_color_bins`.
        """
        total = np.zeros((NUM_CLASSES, *color_bins[0].shape), np.float32)
        for axes, class_counts, bins in zip(self._axes, self._counts, color_bins):
            for k, counts in enumerate(class_counts):
                # Smooth and normalise the histogram of the class.
                smooth = ndimage.gaussian_filter(counts.reshape(axes.shape), axes.blur,
                                                 mode="constant").ravel()
                share = smooth / max(smooth.sum(), 1e-9)
                # Add the floor, and look up every pixel's bin.
                bin_log_likelihood = axes.weight * np.log(
                    share + SETTINGS.floor_share / len(counts))
                total[k] += bin_log_likelihood[bins]
        return total


def normalize_posterior(log_posterior: np.ndarray) -> np.ndarray:
    """Returns probabilities that sum to 1 over the classes.

    Args:
        log_posterior: (3, h, w) float32 log probabilities, up to a constant of each pixel.

    Returns:
        (3, h, w) float32 probabilities.
    """
    p = np.exp(log_posterior - log_posterior.max(axis=0))
    return p / p.sum(axis=0)


def smooth_to_probabilities(log_posterior: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Smooths class probabilities between neighbouring pixels, except across colour edges.

    The operation is mean-field inference in a Potts model on the grid of pixels.

    Source: Kraehenbuehl and Koltun, "Efficient Inference in Fully Connected CRFs with Gaussian
    Edge Potentials" (2011), equation 3, with the four neighbours only.

    Args:
        log_posterior: (3, h, w) float32 logarithms of prior times likelihood, up to a constant
            of each pixel.
        color: (h, w, 3) uint8 RGB.

    Returns:
        (3, h, w) float32 probabilities.
    """
    # Weigh each pair of neighbours by how alike their colours are.
    image = color.astype(np.float32)
    across = _neighbor_weights(np.diff(image, axis=1))
    down = _neighbor_weights(np.diff(image, axis=0))
    p = normalize_posterior(log_posterior)
    for _ in range(SETTINGS.smoothing_rounds):
        # Sum the weighted probabilities of the four neighbours.
        message = np.zeros_like(p)
        message[:, :, 1:] += across * p[:, :, :-1]
        message[:, :, :-1] += across * p[:, :, 1:]
        message[:, 1:] += down * p[:, :-1]
        message[:, :-1] += down * p[:, 1:]
        # Update all pixels at once.
        p = normalize_posterior(log_posterior + message)
    return p


def _neighbor_weights(color_difference: np.ndarray) -> np.ndarray:
    """Returns the (h, w) float32 weights of neighbours from their (h, w, 3) colour differences."""
    similarity = np.exp(-np.sum(color_difference**2, axis=-1) / (6 * SETTINGS.edge_scale**2))
    across_edge = SETTINGS.edge_weight_share
    return SETTINGS.neighbor_weight * (across_edge + (1 - across_edge) * similarity)
