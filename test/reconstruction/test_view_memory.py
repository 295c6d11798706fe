# SPDX-License-Identifier: Apache-2.0
"""What live mode remembers: the newest views, and of one place only the last few."""

import numpy as np
import pytest

from stack_counter import geometry
from stack_counter.reconstruction.view_memory import SETTINGS, ViewMemory
from stack_counter.types import Intrinsics, View

CAMERA = Intrinsics(64, 48, 60.0, 60.0, 31.5, 23.5)


def remembered(*views, live=True):
    """Stamps of the views that are kept of those given: (x in metres, camera, fixed)."""
    memory = ViewMemory(live)
    for i, (x, camera, fixed) in enumerate(views):
        T = geometry.pose(np.eye(3), np.array([x, 0, 1.0]))
        memory.add_view(View(i, CAMERA, T, camera=camera, fixed=fixed))
    return [view.stamp_ns for view in memory.views]


def test_a_scan_keeps_all_views():
    assert remembered(*[(0.0, "a", False)] * 40, live=False) == list(range(40))


@pytest.mark.parametrize("fixed", [True, False])
def test_of_a_camera_that_stands_the_last_two_are_kept(fixed):
    assert remembered(*[(0.0, "a", fixed)] * 5) == [3, 4]


def test_what_a_camera_saw_before_it_came_back_goes():
    """To and fro between two places, each time off by up to 4 mm."""
    views = [(0.3 * (i % 2) + 0.001 * (i % 5), "a", False) for i in range(9)]
    assert remembered(*views) == [5, 6, 7, 8]


def test_a_moving_camera_and_other_cameras_are_other_places():
    assert remembered(*[(0.01 * i, "a", False) for i in range(6)]) == list(range(6))
    assert remembered((0, "a", True), (0, "b", True), (0, "a", True), (0, "a", True)) == [1, 2, 3]


def test_the_newest_views_of_all_places_are_kept():
    count = SETTINGS.newest + 5
    assert remembered(*[(0.1 * i, "a", False) for i in range(count)]) == list(range(5, count))
