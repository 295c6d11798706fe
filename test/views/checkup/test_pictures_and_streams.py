# SPDX-License-Identifier: Apache-2.0
"""Figures of a checkup: how wide edges are, and how far the stamps of two streams lie apart."""

import cv2
import numpy as np
import pytest
from kits.recording_kit import texture

from stack_counter.types import Intrinsics
from stack_counter.views.checkup.pictures import PictureStatistics, edge_widths
from stack_counter.views.checkup.streams import Stream, offsets_ns


@pytest.mark.parametrize("blur_px", [2.0, 4.0, 6.0])
def test_edges_are_as_wide_as_they_were_smoothed(blur_px):
    edges = np.zeros((160, 160, 3), np.uint8)
    edges[:, 80:] = edges[80:] = 200
    widths = edge_widths(cv2.GaussianBlur(edges, (0, 0), blur_px))
    assert np.median(widths) == pytest.approx(blur_px, rel=0.2)


def test_noise_is_not_taken_for_sharpness():
    picture = texture(Intrinsics(320, 240, 300, 300, 160, 120))
    blurred = cv2.GaussianBlur(picture, (0, 0), 6).astype(float)
    noisy = blurred + np.random.default_rng(0).normal(0, 2, blurred.shape)
    figures = PictureStatistics()
    figures.add_color(picture)
    figures.add_color(np.clip(noisy, 0, 255).astype(np.uint8))
    assert figures.sharp[0] == 1 and figures.sharp[1] < 0.3


def test_a_blank_picture_has_nothing_sharp_and_invalid_depth_no_distance():
    figures = PictureStatistics()
    figures.add_color(np.full((120, 160, 3), 90, np.uint8))
    figures.add_depth(np.zeros((4, 4), np.float32))
    assert (figures.sharp, figures.valid, figures.distances) == ([0.0], [0.0], [])


def test_offsets_are_those_of_the_nearest_message():
    depth, color = Stream("d", "depth", [10, 52, 90]), Stream("c", "color", [12, 50, 300])
    assert offsets_ns(depth, color).tolist() == [-2, 2, -210]
    assert len(offsets_ns(Stream("d", "depth"), color)) == 0
