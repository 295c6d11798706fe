# SPDX-License-Identifier: Apache-2.0
"""ADD-S of told poses, symmetric ones included, and the threshold of the fit."""

import numpy as np
import trimesh
from kits.posed_parts import as_mesh

from stack_counter import geometry
from stack_counter.eval.common.pose_errors import PoseError, format_poses, is_right, measure_poses
from stack_counter.types import PartPose

BAR = as_mesh(trimesh.creation.box((0.05, 0.01, 0.01)))
DIAMETER = np.sqrt(0.05**2 + 2 * 0.01**2)
HALF_TURN = np.diag([-1.0, -1, 1])


def measure(T, *true):
    return measure_poses([None, PartPose(T, 0.5)], np.array(true), BAR)


def test_a_symmetric_pose_is_right_and_a_shifted_one_off_by_less_than_the_shift():
    true = geometry.pose(np.eye(3), np.array([0.1, 0.2, 0.3]))
    far = geometry.pose(np.eye(3), np.array([0.5, 0.2, 0.3]))
    [same] = measure(geometry.pose(HALF_TURN, true[:3, 3]), far, true)
    assert same.error < 0.02 and same.fit == 0.5 and same.turned_error > 0.05
    [beside] = measure(geometry.pose(np.eye(3), true[:3, 3] + [0, 0.02, 0]), true)
    assert 0.01 / DIAMETER < beside.error < 0.021 / DIAMETER and not is_right(beside)


def test_the_table_says_from_which_fit_nine_of_ten_are_right():
    errors = [PoseError(0.01, 0.2, 0.9)] * 9 + [PoseError(0.3, 0.07, fit)
                                                for fit in (0.8, 0.7, 0.6)]
    summary, _, right, close = format_poses(errors).splitlines()
    assert summary == "12 poses, median ADD-S 0.010 diameters"
    assert right.split() == ["0.1", "0.750", "0.250", "0.80", "0.833"]
    assert close.split() == ["0.05", "0.750", "0.000", "0.80", "0.833"]
    assert format_poses([PoseError(0.3, 0.3, 0.5)]).splitlines()[2].split()[3:] == ["nan", "0.000"]
    assert is_right(PoseError(0.099, 0, 0)) and not is_right(PoseError(0.101, 0, 0))
