import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.transforms import TransformBuffer

MS = 10**6


def T(x, turn=0.0):
    return geometry.pose(Rotation.from_rotvec([0, 0.3 * turn, turn]).as_matrix(),
                         np.array([x, 0, 0]))


def test_interpolation_is_slerp_and_a_straight_line():
    buffer = TransformBuffer(0.1)
    a, b = T(0.0, 0.1), T(1.0, 0.9)
    buffer.add_transform(100 * MS, "world", "camera", b)
    buffer.add_transform(20 * MS, "world", "camera", a)  # late samples find their place
    got, fixed = buffer.lookup("world", "camera", 40 * MS)
    turn = Slerp([0, 1], Rotation.from_matrix([a[:3, :3], b[:3, :3]]))(0.25).as_matrix()
    np.testing.assert_allclose(got, geometry.pose(turn, np.array([0.25, 0, 0])), atol=1e-12)
    assert not fixed


def test_chain_up_and_down_through_a_common_frame():
    buffer = TransformBuffer(0.1)
    buffer.add_transform(0, "root", "world", T(1, 0.5), static=True)
    buffer.add_transform(0, "root", "arm", T(2, -0.2), static=True)
    buffer.add_transform(0, "arm", "camera", T(3, 0.7), static=True)
    got, fixed = buffer.lookup("world", "camera", 123)
    want = geometry.inverse(T(1, 0.5)) @ T(2, -0.2) @ T(3, 0.7)
    np.testing.assert_allclose(got, want, atol=1e-12)
    assert fixed


@pytest.mark.parametrize("stamp", [-1, 151 * MS, 75 * MS])
def test_no_pose_outside_or_in_a_wide_gap(stamp):
    buffer = TransformBuffer(0.1)
    for at in (0, 150 * MS):
        buffer.add_transform(at, "world", "camera", T(0))
    with pytest.raises(ViewError, match="expected samples at most 100 ms apart") as caught:
        buffer.lookup("world", "camera", stamp)
    assert caught.value.reason == "no_tf"
    buffer.lookup("world", "camera", 150 * MS)  # a sample at the very stamp needs no neighbour


def test_loops_and_islands_are_told_apart():
    buffer = TransformBuffer(0.1)
    buffer.add_transform(0, "a", "b", T(0))
    buffer.add_transform(0, "b", "a", T(0))
    with pytest.raises(ViewError, match="a -> b -> a.*loop|b -> a -> b.*loop") as caught:
        buffer.lookup("world", "b", 0)
    assert caught.value.reason == "tf_loop"
    with pytest.raises(ViewError, match="no transforms connect 'world' and 'camera'"):
        buffer.lookup("world", "camera", 0)


def test_old_samples_are_forgotten():
    buffer = TransformBuffer(0.1)
    for second in range(200):
        buffer.add_transform(second * 10**9, "world", "camera", T(second))
    with pytest.raises(ViewError):
        buffer.lookup("world", "camera", 10 * 10**9)
    assert buffer.lookup("world", "camera", 150 * 10**9)[0][0, 3] == 150
