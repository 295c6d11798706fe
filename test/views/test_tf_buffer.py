# SPDX-License-Identifier: Apache-2.0
"""The transform buffer: interpolation against scipy, gaps, trees, loops, forgetting."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.views import tf_buffer
from stack_counter.views.tf_buffer import TransformBuffer

MS = 10**6
RANDOM = np.random.default_rng(3)


def random_pose():
    return geometry.pose(Rotation.random(rng=RANDOM).as_matrix(), RANDOM.uniform(-1, 1, 3))


def refused(buffer, target, source, stamp, reason):
    with pytest.raises(ViewError) as caught:
        buffer.lookup(target, source, stamp)
    assert caught.value.reason == reason and "\n" not in str(caught.value)
    return str(caught.value)


def buffer_of(*samples, gap=0.1):
    """A buffer of (stamp_ns, T) samples of 'tool' in 'base'."""
    buffer = TransformBuffer(gap)
    for stamp, T in samples:
        buffer.add_transform(stamp, "base", "tool", T)
    return buffer


@pytest.mark.parametrize("stamp", [0, 1, 13 * MS, 50 * MS, 99_999_999, 100 * MS])
def test_interpolation_is_slerp_and_a_straight_line(stamp):
    a, b = random_pose(), random_pose()
    found, fixed = buffer_of((0, a), (100 * MS, b)).lookup("base", "tool", stamp)
    share = stamp / (100 * MS)
    turn = Slerp([0, 100 * MS], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))(stamp)
    assert found[:3, :3] == pytest.approx(turn.as_matrix(), abs=1e-9)
    assert found[:3, 3] == pytest.approx((1 - share) * a[:3, 3] + share * b[:3, 3], abs=1e-12)
    assert not fixed


def test_stamps_of_today_lose_no_nanosecond():
    now = 1_763_856_000_000_000_001
    a, b = np.eye(4), geometry.pose(np.eye(3), np.array([1.0, 0, 0]))
    buffer = buffer_of((now, a), (now + 4, b))
    assert buffer.lookup("base", "tool", now + 1)[0][0, 3] == 0.25
    assert buffer.lookup("base", "tool", now + 4)[0][0, 3] == 1


def test_a_gap_of_exactly_the_limit_is_bridged_and_one_more_nanosecond_is_not():
    a, b = random_pose(), random_pose()
    buffer_of((0, a), (100 * MS, b)).lookup("base", "tool", 50 * MS)
    text = refused(buffer_of((0, a), (100 * MS + 1, b)), "base", "tool", 50 * MS, "no_tf")
    assert "50.0 ms before" in text and "at most 100 ms" in text


@pytest.mark.parametrize("metres, radians, bridged", [
    (0.0, 0.0, True), (0.9e-4, 0.0, True), (1.1e-4, 0.0, False),
    (0.0, 0.9e-4, True), (0.0, 1.1e-4, False)])
def test_a_gap_of_any_width_between_equal_poses_is_bridged(metres, radians, bridged):
    a = random_pose()
    b = a @ geometry.pose(Rotation.from_rotvec([0, radians, 0]).as_matrix(),
                          np.array([0, 0, metres]))
    buffer = buffer_of((0, a), (20_000 * MS, b))
    if bridged:
        assert buffer.lookup("base", "tool", 7_000 * MS)[0] == pytest.approx(a, abs=1e-4)
    else:
        text = refused(buffer, "base", "tool", 7_000 * MS, "no_tf")
        assert "7000.0 ms before and 13000.0 ms after" in text and "tf_max_gap_s" in text


def test_one_joint_that_stands_does_not_bridge_the_gap_of_one_that_moves():
    buffer = buffer_of((0, random_pose()), (110 * MS, random_pose()))
    for stamp in (0, 110 * MS):
        buffer.add_transform(stamp, "world", "base", np.eye(4))
    assert "'tool' in 'base'" in refused(buffer, "world", "tool", 50 * MS, "no_tf")


def test_ten_hertz_joint_states_of_a_standing_arm_lose_no_view():
    """Their stamps jitter by some milliseconds, so that every other gap is above 100 ms."""
    stamps = [int(i * 100 * MS + jitter) for i, jitter in
              enumerate(RANDOM.integers(-8 * MS, 8 * MS, 30))]
    buffer = buffer_of(*((stamp, np.eye(4)) for stamp in stamps))
    assert max(np.diff(stamps)) > 100 * MS
    for stamp in range(200 * MS, 2700 * MS, 33 * MS):
        assert buffer.lookup("base", "tool", stamp)[0] == pytest.approx(np.eye(4))


def test_a_sample_at_the_stamp_needs_no_neighbour():
    T = random_pose()
    assert buffer_of((5, T)).lookup("base", "tool", 5)[0] == pytest.approx(T)


@pytest.mark.parametrize("stamp, text", [(4 * MS, "nothing before"), (16 * MS, "nothing after"),
                                         (7 * MS, None)])
def test_nothing_is_extrapolated(stamp, text):
    buffer = buffer_of((5 * MS, np.eye(4)), (15 * MS, np.eye(4)))
    if text is None:
        buffer.lookup("base", "tool", stamp)
        return
    message = refused(buffer, "base", "tool", stamp, "no_tf")
    before, after = message.split("has ")[1].split(" the image")[0].split(" and ")
    assert text in (before, after)


def test_samples_may_come_in_any_order_and_the_last_of_a_stamp_counts():
    poses = {stamp * MS: random_pose() for stamp in range(0, 200, 10)}
    order = RANDOM.permutation(list(poses))
    buffer = buffer_of(*((int(s), random_pose()) for s in order), *poses.items())
    sorted_buffer = buffer_of(*poses.items())
    for stamp in range(0, 190 * MS, 7 * MS):
        assert buffer.lookup("base", "tool", stamp)[0] \
            == pytest.approx(sorted_buffer.lookup("base", "tool", stamp)[0])


def tree():
    """world -> base (static) -> arm (moving) -> camera (static); base -> bin (static)."""
    T = {name: random_pose() for name in ("base", "arm0", "arm1", "camera", "bin")}
    buffer = TransformBuffer(0.1)
    buffer.add_transform(0, "world", "base", T["base"], static=True)
    buffer.add_transform(0, "base", "arm", T["arm0"])
    buffer.add_transform(80 * MS, "base", "arm", T["arm1"])
    buffer.add_transform(0, "arm", "camera", T["camera"], static=True)
    buffer.add_transform(0, "base", "bin", T["bin"], static=True)
    return buffer, T


def test_a_chain_up_and_down_the_tree():
    buffer, T = tree()
    arm = geometry.interpolate_pose(T["arm0"], T["arm1"], 0.25)
    in_base = arm @ T["camera"]
    found = {target: buffer.lookup(target, "camera", 20 * MS) for target in
             ("world", "base", "bin", "camera")}
    assert found["world"][0] == pytest.approx(T["base"] @ in_base)
    assert found["base"][0] == pytest.approx(in_base)
    assert found["bin"][0] == pytest.approx(geometry.inverse(T["bin"]) @ in_base)
    assert found["camera"][0] == pytest.approx(np.eye(4))
    back, _ = buffer.lookup("camera", "bin", 20 * MS)
    assert back @ found["bin"][0] == pytest.approx(np.eye(4))


def test_only_a_wholly_static_chain_is_fixed():
    buffer, _ = tree()
    assert buffer.lookup("world", "bin", 10**15)[1] is True  # static: at any stamp
    assert buffer.lookup("world", "camera", 20 * MS)[1] is False


def test_frames_that_are_not_connected_are_named_with_those_known():
    buffer, _ = tree()
    text = refused(buffer, "map", "camera", 20 * MS, "no_tf")
    assert "'map'" in text and "'camera'" in text and "'bin'" in text
    assert "known frames: ['arm', 'base', 'bin', 'camera', 'world']" in text  # the root too
    assert "set world_frame to 'world'" in text  # which would have worked
    assert "none" in refused(TransformBuffer(0.1), "a", "b", 0, "no_tf")


def test_a_camera_that_no_transform_names_gets_no_world_frame_advised():
    buffer, _ = tree()
    text = refused(buffer, "base", "camera2", 20 * MS, "no_tf")
    assert "no transform names 'camera2'" in text and "world_frame" not in text


def test_trees_that_are_apart_are_named_by_the_root_of_the_camera():
    buffer, _ = tree()
    buffer.add_transform(0, "table", "station", np.eye(4), static=True)
    text = refused(buffer, "station", "camera", 20 * MS, "no_tf")
    assert "set world_frame to 'world'" in text
    assert "a transform between it and 'station'" in text


@pytest.mark.parametrize("names", ["a", "ab", "abc"])
def test_a_loop_is_named_and_ends(names):
    buffer = TransformBuffer(0.1)
    for child, parent in zip(names, names[1:] + names[0]):
        buffer.add_transform(0, parent, child, np.eye(4))
    text = refused(buffer, "world", "a", 0, "tf_loop")
    assert " -> ".join([*names, "a"]) in text
    assert buffer.is_ready("world", "a", 0)  # waiting mends nothing


def test_a_frame_with_a_new_parent_forgets_the_old_one():
    buffer = buffer_of((0, np.eye(4)))
    T = random_pose()
    buffer.add_transform(1, "other", "tool", T)
    refused(buffer, "base", "tool", 0, "no_tf")
    assert buffer.lookup("other", "tool", 1)[0] == pytest.approx(T)


def test_a_later_static_transform_replaces_the_earlier():
    buffer, T = TransformBuffer(0.1), random_pose()
    buffer.add_transform(7, "base", "tool", np.eye(4), static=True)
    buffer.add_transform(7, "base", "tool", T, static=True)
    assert buffer.lookup("base", "tool", 0)[0] == pytest.approx(T)


def test_ready_waits_for_a_sample_at_or_after_the_stamp():
    buffer = TransformBuffer(0.1)
    assert not buffer.is_ready("base", "tool", 10)
    buffer.add_transform(9, "base", "tool", np.eye(4))
    assert not buffer.is_ready("base", "tool", 10)
    buffer.add_transform(10, "base", "tool", np.eye(4))
    assert buffer.is_ready("base", "tool", 10)


def test_old_samples_are_forgotten():
    buffer = buffer_of(*((s * 10**9, np.eye(4)) for s in (0, 10, 100)))
    refused(buffer, "base", "tool", 10 * 10**9, "no_tf")
    buffer.lookup("base", "tool", 100 * 10**9)
    long = buffer_of(*((i * 50 * MS, np.eye(4)) for i in range(4000)))
    long.lookup("base", "tool", 199 * 10**9)
    assert max(len(e.stamps) for e in long._edges.values()) <= 1201  # 60 s at 20 Hz


def test_a_sample_older_than_all_that_is_kept_does_no_harm():
    buffer = buffer_of((100 * 10**9, np.eye(4)))
    buffer.add_transform(1, "base", "tool", random_pose())
    refused(buffer, "base", "tool", 1, "no_tf")
    assert buffer.lookup("base", "tool", 100 * 10**9)[0] == pytest.approx(np.eye(4))


def test_a_storm_of_samples_or_frames_takes_no_more_memory(monkeypatch):
    monkeypatch.setattr(tf_buffer, "SETTINGS",
                        replace(tf_buffer.SETTINGS, kept_samples=5, frames=3))
    buffer = TransformBuffer(0.1)
    for i in range(9):
        buffer.add_transform(i, "base", "tool", random_pose())
    assert buffer._edges["tool"].stamps == [4, 5, 6, 7, 8]
    for name in "ab":
        buffer.add_transform(0, "base", name, np.eye(4))
    with pytest.raises(ViewError, match="frame 'c' beside 3 others; expected at most 3"):
        buffer.add_transform(0, "base", "c", np.eye(4))
    buffer.add_transform(9, "base", "tool", np.eye(4))  # known frames go on
    assert buffer._edges["tool"].stamps[-1] == 9
