# SPDX-License-Identifier: Apache-2.0
"""The first view: prompts say what may be what, and colours are learnt and used in turn."""

from __future__ import annotations

import cv2
import numpy as np

from stack_counter.segmentation.prompted.color_models import (
    CLASSES,
    NEVER,
    ColorModels,
    posterior,
    smoothed,
)
from stack_counter.segmentation.prompts import Prompts
from stack_counter.types import BACKGROUND, CONTAINER, PARTS

_ROUNDS = 8  # of learning and labelling
_GUIDED = 3  # of them in which points count for more than themselves
_POINT = 2  # pixels around a point that show the same
_FRAME = 0.03  # of the image that is background if there are points but no box
_OPEN = 0.3  # probability of background of what stands, if no container is marked: it may be one
_PARTS = 0.6  # share of parts in what is not background, where both are marked
_LOW, _UNLIKELY = 1e-3, 1e-4


def marked(prompts: Prompts, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) bool pixels of the first view that may show parts or container."""
    return _area(prompts.part_boxes, prompts.part_points, shape) \
        | _area(prompts.container_boxes, prompts.container_points, shape)


def prompted_prior(background: np.ndarray, prompts: Prompts) -> tuple[np.ndarray, np.ndarray]:
    """What the prompts say of the pixels of the first view.

    Args:
        background: (h, w) float32 probability of background without any prompt.
        prompts: in pixels of the same image.

    Returns:
        (3, h, w) float32 probabilities, and (3, h, w) bool pixels around the points of each class.
    """
    shape = background.shape
    parts = _area(prompts.part_boxes, prompts.part_points, shape)
    container = _area(prompts.container_boxes, prompts.container_points, shape)
    prior = _prior(parts, container, background, prompts.with_container)
    points = _points(prompts, shape)
    for k, at in enumerate(points):
        prior[:, at] = _LOW
        prior[k, at] = 1
    return prior, points


def label_first(color: np.ndarray, bins: list[np.ndarray], prior: np.ndarray, points: np.ndarray,
                looks: ColorModels) -> np.ndarray:
    """Labels the first view while the class models are learnt from it.

    Args:
        color: (h, w, 3) uint8 RGB of the first view.
        bins: its `color_bins`.
        prior, points: as `prompted_prior` gives them.
        looks: class models; what they have learnt before is forgotten.

    Returns:
        (3, h, w) float32 probabilities.
    """
    log_prior = np.log(prior)
    p = posterior(log_prior)
    for i in range(_ROUNDS):
        looks.clear()
        looks.add(bins, p)
        if i < _GUIDED:
            looks.add(bins, _emphasis(p, points))
        p = smoothed(log_prior + looks.log(bins), color)
    return p


def _area(boxes: np.ndarray, points: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """(h, w) bool pixels inside boxes; with points alone, all but a frame of the image."""
    area = np.zeros(shape, bool)
    for x0, y0, x1, y1 in np.round(boxes).astype(int):
        area[y0:y1 + 1, x0:x1 + 1] = True
    if len(points) and not len(boxes):
        frame = int(np.ceil(_FRAME * min(shape)))
        area[frame:-frame, frame:-frame] = True
    return area


def _points(prompts: Prompts, shape: tuple[int, int]) -> np.ndarray:
    """(3, h, w) bool pixels around the points of each class."""
    out = np.zeros((CLASSES, *shape), np.uint8)
    for k, points in ((BACKGROUND, prompts.background_points),
                      (CONTAINER, prompts.container_points), (PARTS, prompts.part_points)):
        for x, y in np.round(points).astype(int):
            cv2.circle(out[k], (int(x), int(y)), _POINT, 1, -1)
    return out > 0


def _prior(parts: np.ndarray, container: np.ndarray, background: np.ndarray,
           with_container: bool) -> np.ndarray:
    """(3, h, w) float32 probabilities before any colour is looked at, from (h, w) areas."""
    prior = np.full((CLASSES, *parts.shape), _UNLIKELY, np.float32)
    prior[BACKGROUND] = np.where(parts | container, background, 1)
    if not with_container:
        prior[CONTAINER] = NEVER
        prior[BACKGROUND, parts] = np.maximum(background[parts], _OPEN)
        prior[PARTS, parts] = 1 - prior[BACKGROUND, parts]
        return prior
    inside = 1 - background
    prior[CONTAINER, container] = inside[container]
    prior[CONTAINER, parts] = (1 - _PARTS) * inside[parts]
    prior[PARTS, parts] = _PARTS * inside[parts]
    return prior


def _emphasis(p: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(3, h, w) weights: pixels around points stand for half as many as their class has."""
    counts = points.sum(axis=(1, 2))
    share = np.where(counts > 0, 0.5 * p.sum(axis=(1, 2)) / np.maximum(counts, 1), 0)
    return points * share[:, None, None]
