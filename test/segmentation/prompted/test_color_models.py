# SPDX-License-Identifier: Apache-2.0
"""Colour models and smoothing on images of one or two colours."""

import numpy as np
import pytest

from stack_counter.segmentation.prompted.color_models import (
    NUM_CLASSES,
    SETTINGS,
    ColorModels,
    compute_color_bins,
    normalize_posterior,
    smooth_to_probabilities,
)
from stack_counter.types import BACKGROUND, PARTS

RED, BLUE = (200, 40, 40), (40, 40, 200)


def halves(left, right, shape=(8, 20)):
    image = np.empty((*shape, 3), np.uint8)
    image[:, :shape[1] // 2], image[:, shape[1] // 2:] = left, right
    return image


def test_shading_keeps_hue():
    bright, dark = halves(RED, RED), halves(RED, RED) // 2
    (hue, brightness), (dark_hue, dark_brightness) = map(compute_color_bins, (bright, dark))
    step = np.abs(np.array(np.divmod(hue, 32)) - np.array(np.divmod(dark_hue, 32)))
    assert step.max() <= 1
    assert np.all(dark_brightness < brightness)


def test_the_class_that_had_a_colour_is_likelier():
    image = halves(RED, BLUE)
    weights = np.zeros((NUM_CLASSES, *image.shape[:2]))
    weights[BACKGROUND, :, :10] = weights[PARTS, :, 10:] = 1
    models, bins = ColorModels(), compute_color_bins(image)
    models.add_image(bins, weights)
    likelihood = models.log_likelihood(bins)
    assert np.all(likelihood[BACKGROUND, :, :8] > likelihood[PARTS, :, :8])
    assert np.all(likelihood[PARTS, :, 12:] > likelihood[BACKGROUND, :, 12:])
    models.reset()
    empty = models.log_likelihood(bins)
    assert np.ptp(empty, axis=0).max() == 0


def test_posterior_is_softmax():
    p = normalize_posterior(np.log(np.array([1.0, 2.0, 5.0])).reshape(3, 1, 1) + 700)
    assert p.ravel() == pytest.approx([0.125, 0.25, 0.625])


def test_smoothing_fills_a_hole_but_keeps_an_edge():
    log_posterior = np.zeros((NUM_CLASSES, 8, 20), np.float32)
    log_posterior[BACKGROUND, :, :10] = log_posterior[PARTS, :, 10:] = 2
    log_posterior[:, 4, 4] = 0  # an undecided pixel inside the left surface
    p = smooth_to_probabilities(log_posterior, halves(RED, BLUE))
    assert p[BACKGROUND, 4, 4] > 0.95
    assert np.all(p[BACKGROUND, :, :10] > 0.9) and np.all(p[PARTS, :, 10:] > 0.9)


def test_an_edge_of_colour_weakens_the_neighbour():
    log_posterior = np.zeros((NUM_CLASSES, 1, 2), np.float32)
    log_posterior[PARTS, 0, 1] = 3  # the left pixel is undecided
    plain = smooth_to_probabilities(log_posterior, halves(RED, RED, (1, 2)))[PARTS, 0, 0]
    edge = smooth_to_probabilities(log_posterior, halves(RED, BLUE, (1, 2)))[PARTS, 0, 0]
    # One neighbour whose label is certain: log odds of its weight.
    weight = SETTINGS.neighbor_weight * SETTINGS.edge_weight_share
    assert plain > 0.6
    assert edge == pytest.approx(np.exp(weight) / (np.exp(weight) + 2), abs=0.01)
