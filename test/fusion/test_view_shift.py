# SPDX-License-Identifier: Apache-2.0
"""How far apart two views show one scene."""

from dataclasses import replace

import numpy as np
import pytest
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.fusion.region import Region
from stack_counter.fusion.view_shift import Agreement, measure_agreement, measure_shift

REGION = Region(np.array([-0.2, -0.15, -0.04]), np.array([0.2, 0.15, 0.17]), 0.0, 0.001)
VIEWS = Scene().bin((0.3, 0.2, 0.12), 0.005, 0.005, 0.07).views(6, noise=0.0004)


def shifted(view, shift):
    return replace(view, T_world_camera=geometry.pose(np.eye(3), shift) @ view.T_world_camera)


def test_views_with_true_poses_are_not_apart():
    assert measure_agreement(VIEWS, REGION).some_m < 0.0008


@pytest.mark.parametrize("shift", [(0.002, 0, 0), (0.001, 0.001, 0.001)])
def test_a_shift_of_one_view_is_measured(shift):
    moved = shifted(VIEWS[1], np.array(shift))
    assert measure_shift(VIEWS[0], moved, REGION) == pytest.approx(np.linalg.norm(shift), rel=0.2)


def test_views_of_other_places_say_nothing():
    elsewhere = shifted(VIEWS[1], np.array([5.0, 0, 0]))
    assert measure_shift(VIEWS[0], elsewhere, REGION) is None
    assert measure_agreement([VIEWS[0]], REGION) == Agreement()
