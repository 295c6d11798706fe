# SPDX-License-Identifier: Apache-2.0
"""The prior that boxes and points give in the first view."""

import numpy as np
import pytest

from stack_counter.segmentation.prompted.first_view import (
    SETTINGS,
    compute_prompted_prior,
    find_marked_area,
)
from stack_counter.segmentation.prompts import parse_prompts
from stack_counter.types import BACKGROUND, CONTAINER, PARTS

SHAPE = 40, 60
BACKGROUND_PRIOR = np.full(SHAPE, 0.2, np.float32)


def test_boxes_bound_what_may_show_parts():
    prompts = parse_prompts({"parts": {"boxes": [[10, 5, 20, 15]]}})
    area = find_marked_area(prompts, SHAPE)
    assert np.count_nonzero(area) == 11 * 11 and area[5, 10] and area[15, 20]
    prior = compute_prompted_prior(BACKGROUND_PRIOR, prompts).probabilities
    assert np.all(prior[BACKGROUND, ~area] == 1)
    # An unmarked container may stand in the box.
    assert prior[:, 10, 15] == pytest.approx(
        [SETTINGS.min_background, 0, 1 - SETTINGS.min_background], abs=1e-6)


def test_container_and_parts_share_what_is_not_background():
    prompts = parse_prompts({"parts": {"boxes": [[10, 5, 20, 15]]},
                             "container": {"boxes": [[5, 2, 30, 30]]}})
    prior = compute_prompted_prior(BACKGROUND_PRIOR, prompts).probabilities
    share = SETTINGS.parts_share
    assert prior[:, 10, 15] == pytest.approx([0.2, 0.8 * (1 - share), 0.8 * share])
    assert prior[:, 25, 25] == pytest.approx([0.2, 0.8, SETTINGS.unmarked_probability])


def test_points_set_the_class_around_them():
    prompts = parse_prompts({"parts": {"points": [[30, 20]]}, "background": {"points": [[3, 4]]}})
    prior = compute_prompted_prior(BACKGROUND_PRIOR, prompts)
    assert prior.points[PARTS, 20, 30 + SETTINGS.point_radius_px]
    assert prior.points[BACKGROUND, 4, 3] and not prior.points[CONTAINER].any()
    assert prior.probabilities[:, 20, 30] == pytest.approx(
        [SETTINGS.point_error, SETTINGS.point_error, 1])
    # Points alone: all but a frame of the image may show parts.
    area = find_marked_area(prompts, SHAPE)
    assert not area[0].any() and not area[:, -1].any() and area[2:-2, 2:-2].all()
