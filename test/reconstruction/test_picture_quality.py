# SPDX-License-Identifier: Apache-2.0
"""What is said of pictures that are too coarse, blurred or over-exposed."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.config import ReconstructorConfig
from stack_counter.reconstruction import PictureReconstruction
from stack_counter.reconstruction.picture_quality import picture_doubts
from stack_counter.types import CONTAINER, PARTS, Intrinsics, View

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)
# 15 pixels wide from 0.5 m: a ball of 25 mm.
BALL = np.pi / 6 * 0.025**3


def picture(distance=0.5):
    """A view from straight above the origin on parts with a sharp pattern."""
    grey = np.random.default_rng(0).integers(60, 200, (60, 80), np.uint8)
    grey = cv2.resize(grey, (320, 240), interpolation=cv2.INTER_NEAREST)
    labels = np.full((240, 320), CONTAINER, np.uint8)
    labels[40:200, 60:260] = PARTS
    T = geometry.pose(np.diag([1.0, -1.0, -1.0]), np.array([0.0, 0.0, distance]))
    return View(0, CAMERA, T, np.repeat(grey[..., None], 3, axis=2), None, labels)


def doubts(views, unit_volume=BALL):
    return picture_doubts(views, np.zeros(3), unit_volume)


def test_nothing_is_said_of_good_pictures():
    assert doubts([picture()] * 30) == ()


def test_the_best_view_decides_whether_parts_are_too_small():
    assert doubts([picture(1.1), picture(1.2)]) == ("low_resolution",)
    assert doubts([picture(1.1), picture(0.5)]) == ()
    assert doubts([picture(1.1)], unit_volume=0.0) == ()


@pytest.mark.parametrize("few, said", [(4, ()), (6, ("blurred_pictures",))])
def test_blur_is_said_if_most_pictures_are_blurred(few, said):
    sharp = picture()
    blurred = replace(sharp, color=cv2.GaussianBlur(sharp.color, (0, 0), 5))
    assert doubts([blurred] * few + [sharp] * (10 - few)) == said


def test_white_parts_are_said_and_a_white_background_is_not():
    view = picture()
    white = np.where((view.labels == PARTS)[..., None], np.maximum(view.color, 252), view.color)
    assert "overexposed" in doubts([replace(view, color=white)])
    around = np.where((view.labels == PARTS)[..., None], view.color, 255).astype(np.uint8)
    assert doubts([replace(view, color=around)]) == ()


def test_a_scan_of_label_images_alone_says_that_its_parts_are_too_small():
    """Three outlines of a ball of 10 cm, along the axes, and parts of 5 mm."""
    u, v = np.meshgrid(np.arange(320) - 159.5, np.arange(240) - 119.5)
    ball = np.hypot(u, v) < 300 * np.tan(np.arcsin(0.05 / 0.5))
    labels = np.where(ball, PARTS, 0).astype(np.uint8)
    scans = []
    for part in (0.005, 0.03):
        scan = PictureReconstruction(ReconstructorConfig(), np.pi / 6 * part**3)
        for axis in np.eye(3):
            R = np.stack([np.roll(axis, 1), np.roll(axis, 2), axis], axis=1)
            scan.add_view(View(0, CAMERA, geometry.pose(R, -0.5 * axis), None, None, labels))
        scans.append(scan.measure_volume(taught=None).reasons)
    assert scans == [("no_depth", "low_resolution"), ("no_depth",)]
