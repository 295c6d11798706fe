# SPDX-License-Identifier: Apache-2.0
"""Labels of the first view: prompts give the prior; colour models and labels are fitted in turn.

Source of the alternation: Rother, Kolmogorov and Blake, "GrabCut" (2004); here with three classes.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.segmentation.prompted.color_models import (
    NUM_CLASSES,
    RULED_OUT,
    ColorModels,
    normalize_posterior,
    smooth_to_probabilities,
)
from stack_counter.segmentation.prompts import Prompts
from stack_counter.types import BACKGROUND, CONTAINER, PARTS


@dataclass(frozen=True)
class FirstViewSettings:
    """How much prompts weigh in the first view; all chosen.

    Attributes:
        rounds: number of times that colour models and labels are fitted in turn.
        point_rounds: number of first rounds in which prompted points have extra weight in the
            colour models.
        point_weight_share: extra weight of a class's prompted points together, over the weight
            of all pixels of the class.
        point_radius_px: radius of the disc around a prompted point that shows its class, pixels.
        frame_share: width of the frame that is background where a class has points but no box,
            over the shorter side of the image.
        min_background: least probability of background inside the parts' boxes if no container
            is marked, as an unmarked container may stand there.
        parts_share: share of parts in what is not background, where parts and container are
            both marked.
        unmarked_probability: probability of container or parts outside of their marked areas.
        point_error: probability of each class other than the prompted one at a prompted point.
    """

    rounds: int = 8
    point_rounds: int = 3
    point_weight_share: float = 0.5
    point_radius_px: int = 2
    frame_share: float = 0.03
    min_background: float = 0.3
    parts_share: float = 0.6
    unmarked_probability: float = 1e-4
    point_error: float = 1e-3


SETTINGS = FirstViewSettings()


@dataclass(frozen=True, eq=False)
class PromptedPrior:
    """Class probabilities of the first view's pixels from prompts, before colours are used.

    Attributes:
        probabilities: (3, h, w) float32.
        points: (3, h, w) bool, pixels around the prompted points of each class.
    """

    probabilities: np.ndarray
    points: np.ndarray


def find_marked_area(prompts: Prompts, shape: tuple[int, int]) -> np.ndarray:
    """Returns the (h, w) bool pixels of the first view that may show parts or container."""
    return _class_area(prompts.part_boxes, prompts.part_points, shape) \
        | _class_area(prompts.container_boxes, prompts.container_points, shape)


def compute_prompted_prior(background: np.ndarray, prompts: Prompts) -> PromptedPrior:
    """Computes the class probabilities of the first view's pixels from prompts.

    Args:
        background: (h, w) float32 probability of background without any prompt.
        prompts: marks in pixels of the same image.
    """
    # Take the prior from the marked areas.
    shape = background.shape
    parts_area = _class_area(prompts.part_boxes, prompts.part_points, shape)
    container_area = _class_area(prompts.container_boxes, prompts.container_points, shape)
    prior = _prior_from_areas(parts_area, container_area, background, prompts.with_container)
    # Set the class at the prompted points.
    points = _draw_points(prompts, shape)
    for k, class_points in enumerate(points):
        prior[:, class_points] = SETTINGS.point_error
        prior[k, class_points] = 1
    return PromptedPrior(probabilities=prior, points=points)


def label_first_view(color: np.ndarray, color_bins: list[np.ndarray], prior: PromptedPrior,
                     color_models: ColorModels) -> np.ndarray:
    """Labels the first view while the colour models are fitted to it.

    Args:
        color: (h, w, 3) uint8 RGB of the first view.
        color_bins: `compute_color_bins` of `color`.
        prior: class probabilities from prompts, of the same pixels.
        color_models: histograms of the classes; those of other images are dropped.

    Returns:
        (3, h, w) float32 probabilities.
    """
    log_prior = np.log(prior.probabilities)
    p = normalize_posterior(log_prior)
    for i in range(SETTINGS.rounds):
        # Fit the colour models to the labels; prompted points weigh more at first.
        color_models.reset()
        color_models.add_image(color_bins, p)
        if i < SETTINGS.point_rounds:
            color_models.add_image(color_bins, _point_weights(p, prior.points))
        # Label by prior, colours and neighbours.
        p = smooth_to_probabilities(log_prior + color_models.log_likelihood(color_bins), color)
    return p


def _class_area(boxes: np.ndarray, points: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Returns the (h, w) bool pixels that may show a class.

    These are the pixels inside its boxes; if it has points alone, all but a frame of the image.
    """
    area = np.zeros(shape, bool)
    for x0, y0, x1, y1 in np.round(boxes).astype(int):
        area[y0:y1 + 1, x0:x1 + 1] = True
    if len(points) and not len(boxes):
        frame = int(np.ceil(SETTINGS.frame_share * min(shape)))
        area[frame:-frame, frame:-frame] = True
    return area


def _draw_points(prompts: Prompts, shape: tuple[int, int]) -> np.ndarray:
    """Returns the (3, h, w) bool pixels around the prompted points of each class."""
    out = np.zeros((NUM_CLASSES, *shape), np.uint8)
    for k, points in ((BACKGROUND, prompts.background_points),
                      (CONTAINER, prompts.container_points), (PARTS, prompts.part_points)):
        for x, y in np.round(points).astype(int):
            cv2.circle(out[k], (int(x), int(y)), SETTINGS.point_radius_px, 1, -1)
    return out > 0


def _prior_from_areas(parts_area: np.ndarray, container_area: np.ndarray, background: np.ndarray,
                      with_container: bool) -> np.ndarray:
    """Returns (3, h, w) float32 class probabilities from the marked areas.

    Args:
        parts_area: (h, w) bool, pixels that may show parts.
        container_area: (h, w) bool, pixels that may show the container.
        background: (h, w) float32 probability of background without any prompt.
        with_container: whether the container is marked.
    """
    # Outside of the marked areas lies background.
    prior = np.full((NUM_CLASSES, *parts_area.shape), SETTINGS.unmarked_probability, np.float32)
    prior[BACKGROUND] = np.where(parts_area | container_area, background, 1)
    # Without a marked container, rule it out and split parts from background.
    if not with_container:
        prior[CONTAINER] = RULED_OUT
        prior[BACKGROUND, parts_area] = np.maximum(background[parts_area],
                                                   SETTINGS.min_background)
        prior[PARTS, parts_area] = 1 - prior[BACKGROUND, parts_area]
        return prior
    # Split what is not background into container and parts.
    foreground = 1 - background
    prior[CONTAINER, container_area] = foreground[container_area]
    prior[CONTAINER, parts_area] = (1 - SETTINGS.parts_share) * foreground[parts_area]
    prior[PARTS, parts_area] = SETTINGS.parts_share * foreground[parts_area]
    return prior


def _point_weights(probabilities: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Returns (3, h, w) weights of the pixels around prompted points in the colour models.

    All points of a class weigh together `point_weight_share` of all pixels of the class.
    """
    counts = points.sum(axis=(1, 2))
    class_pixels = probabilities.sum(axis=(1, 2))
    weight = np.where(counts > 0, SETTINGS.point_weight_share * class_pixels
                      / np.maximum(counts, 1), 0)
    return points * weight[:, None, None]
