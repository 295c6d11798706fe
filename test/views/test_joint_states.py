# SPDX-License-Identifier: Apache-2.0
"""Joint positions at a stamp: interpolated, joined from several publishers, or refused."""

import math

import pytest
from kits.robot import joint_state

from stack_counter.errors import ViewError
from stack_counter.views.joint_states import JointStates

MS = 1_000_000


def states(*samples, names=("a", "b"), needed=("a", "b")):
    """Joint states of (stamp, ms, positions)."""
    joints = JointStates(needed, "/joint_states", 0.1)
    for stamp_ms, positions in samples:
        joints.add_message(joint_state(stamp_ms * MS, names, positions))
    return joints


def test_positions_are_interpolated_between_samples_in_any_order():
    joints = states((40, (2.0, 0.0)), (0, (1.0, -1.0)), (80, (9.0, 9.0)))
    assert joints.positions_at(10 * MS) == pytest.approx({"a": 1.25, "b": -0.75})
    assert joints.positions_at(40 * MS) == {"a": 2.0, "b": 0.0}


def test_publishers_that_name_some_of_the_joints_are_joined():
    joints = JointStates(("a", "finger"), "/joint_states", 0.1)
    for stamp in (0, 50):
        joints.add_message(joint_state(stamp * MS, ("other", "a"), (5.0, 1.0)))
    assert not joints.is_ready(20 * MS)
    for stamp in (10, 30):
        joints.add_message(joint_state(stamp * MS, ("finger",), (0.01 * stamp,)))
    assert joints.is_ready(30 * MS) and not joints.is_ready(31 * MS)
    assert joints.positions_at(20 * MS) == pytest.approx({"a": 1.0, "finger": 0.2})


@pytest.mark.parametrize("samples, stamp_ms, said", [
    ((), 0, "joint 'a' never came on /joint_states; expected samples of 2 joints"),
    (((0, (0.0, 0.0)),), 10, "joint 'a' has 10.0 ms before and nothing after the image"),
    (((10, (0.0, 0.0)),), 5, "has nothing before and 5.0 ms after"),
    (((0, (0.0, 0.0)), (150, (1.0, 0.0))), 50, "50.0 ms before and 100.0 ms after"),
    (((0, (math.nan, 0.0)), (10, (math.nan, 0.0))), 5, "joint 'a' never came")])
def test_without_samples_around_it_an_image_has_no_joint_state(samples, stamp_ms, said):
    with pytest.raises(ViewError, match=said) as raised:
        states(*samples).positions_at(stamp_ms * MS)
    assert raised.value.reason == "no_joint_state"


def test_an_arm_at_rest_needs_no_samples_near_the_image():
    joints = states((0, (0.5, 0.2)), (900, (0.5004, 0.2)))
    assert joints.positions_at(450 * MS) == pytest.approx({"a": 0.5002, "b": 0.2})


def test_a_joint_without_end_is_followed_past_half_a_turn():
    joints = states((0, (3.1, 0.0)), (20, (-3.1, 0.0)))
    assert joints.positions_at(10 * MS)["a"] == pytest.approx(math.pi)


def test_a_clock_that_is_set_back_begins_anew():
    joints = states((5000, (1.0, 1.0)), (10, (2.0, 2.0)), (30, (2.0, 2.0)))
    assert joints.positions_at(20 * MS) == {"a": 2.0, "b": 2.0}
    assert not joints.is_ready(31 * MS)


def test_what_is_old_is_forgotten():
    joints = states((0, (1.0, 1.0)), (10, (1.0, 1.0)), (70_000, (1.0, 1.0)))
    with pytest.raises(ViewError, match="nothing before"):
        joints.positions_at(5 * MS)
