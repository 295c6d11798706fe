# SPDX-License-Identifier: Apache-2.0
"""Corrections of poses from measured motions of pairs."""

import numpy as np
import pytest

from stack_counter.fusion.pose_graph import (
    PairMotion,
    motion_about,
    solve_pose_graph,
    transform_about,
)

PIVOT = np.array([0.1, -0.2, 0.05])
CAMERAS = PIVOT + 0.6 * np.array([[np.cos(a), np.sin(a), 1] for a in np.arange(8) * np.pi / 4])


def ring(errors):
    """Motions that each view measures to the next two, for corrections that undo the errors."""
    count = len(errors)
    return [PairMotion(i, (i + step) % count, errors[i] - errors[(i + step) % count])
            for i in range(count) for step in (1, 2)]


def test_a_motion_about_a_pivot_comes_back():
    motion = np.array([0.01, -0.02, 0.005, 0.003, 0.001, -0.002])
    assert motion_about(transform_about(motion, PIVOT), PIVOT) == pytest.approx(motion, abs=1e-12)


def test_pairs_without_motion_leave_the_poses():
    corrections = solve_pose_graph(ring(np.zeros((8, 6))), CAMERAS, PIVOT)
    assert corrections == pytest.approx(np.zeros((8, 6)), abs=1e-12)


def test_no_pairs_leave_the_poses():
    assert solve_pose_graph([], CAMERAS, PIVOT) == pytest.approx(np.zeros((8, 6)))


def test_errors_of_single_views_are_undone_but_for_what_is_common():
    errors = np.random.default_rng(0).normal(0, 0.002, (8, 6))
    left = errors + solve_pose_graph(ring(errors), CAMERAS, PIVOT)
    assert np.abs(left - left.mean(axis=0)).max() < 0.15 * np.abs(errors).max()


def test_one_pair_that_is_wrong_is_outvoted():
    errors = np.random.default_rng(0).normal(0, 0.002, (8, 6))
    pairs = ring(errors)
    pairs[3] = PairMotion(pairs[3].first, pairs[3].second, pairs[3].motion + 0.05)
    left = errors + solve_pose_graph(pairs, CAMERAS, PIVOT)
    assert np.abs(left - left.mean(axis=0)).max() < 0.25 * np.abs(errors).max()
