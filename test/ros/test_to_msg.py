"""Core types survive the way through messages."""

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from scipy.spatial.transform import Rotation
from stack_counter_msgs.msg import PosedImage
from stack_counter_msgs.msg import StackCount as StackCountMsg
from stack_counter_msgs.msg import StackVolume as VolumeMsg

from stack_counter import geometry
from stack_counter.ros import to_msg
from stack_counter.ros.from_msg import from_posed_image, from_stack_count, from_stack_volume
from stack_counter.types import (
    Container,
    HeightMap,
    Intrinsics,
    KeyView,
    StackCount,
    StackVolume,
    View,
    ViewTally,
)

RANDOM = np.random.default_rng(3)
T = geometry.pose(Rotation.from_rotvec([0.3, -2.0, 1.1]).as_matrix(), np.array([0.1, -0.2, 0.7]))
K = Intrinsics(6, 4, 610.5, 611.5, 2.5, 1.5, "plumb_bob", (0.1, -0.2, 0.001, 0.002, 0.03))


def through_dds(message):
    return deserialize_message(serialize_message(message), type(message))


def volume():
    key = KeyView(7, K, T, 5, np.full((4, 6), 2, np.uint8), np.full((4, 6), 0.5, np.float32),
                  RANDOM.integers(0, 255, (4, 6, 3)).astype(np.uint8))
    heights = RANDOM.normal(0.1, 0.01, (5, 3)).astype(np.float32)
    heights[2, 1] = np.nan
    return StackVolume(
        1_700_000_000_123_456_789, 1.25e-3, 2e-5,
        Container("box", T, (0.3, 0.2, 0.1), 0.004, 0.003), (0.1, 0.5, 0.9), 0.87,
        HeightMap(T, 0.002, heights), HeightMap(T, 0.002, np.zeros((5, 3), np.float32)), key,
        ViewTally(12, 10, {"no_tf": 1, "blurred": 1}), ("low_coverage",), {"finish": 0.25})


def test_posed_image_keeps_every_pixel_and_pose():
    depth = RANDOM.uniform(0.3, 1, (4, 6)).astype(np.float32)
    depth[0, 0] = 0
    view = View(1_700_000_000_000_000_001, K, T, RANDOM.integers(0, 255, (4, 6, 3), np.uint8),
                depth, RANDOM.integers(0, 3, (4, 6)).astype(np.uint8), "optical", True)
    message = to_msg.to_posed_image(view, "base_link", "scan", "nut", 1e-6)
    back = from_posed_image(through_dds(message))
    assert (back.stamp_ns, back.camera, back.fixed) == (view.stamp_ns, "optical", True)
    assert back.intrinsics == K
    for name in ("color", "depth", "labels"):
        np.testing.assert_array_equal(getattr(back, name), getattr(view, name))
    np.testing.assert_allclose(back.T_world_camera, T, atol=1e-12)


def test_view_without_depth_stays_without():
    view = View(5, K, T, RANDOM.integers(0, 255, (4, 6, 3), np.uint8), camera="optical")
    back = from_posed_image(through_dds(to_msg.to_posed_image(view, "w", "s", "", 0.0)))
    assert back.depth is None and back.labels is None


def test_volume_and_count_survive():
    v = volume()
    request = PosedImage(scan_id="s1", part="nut", unit_volume=1e-6)
    message = through_dds(to_msg.to_stack_volume(v, "base_link", request, final=True))
    assert (message.scan_id, message.part, message.final) == ("s1", "nut", True)
    back = from_stack_volume(message)
    assert (back.stamp_ns, back.stack_volume, back.views, back.reasons) == (
        v.stamp_ns, v.stack_volume, v.views, v.reasons)
    np.testing.assert_array_equal(back.top.heights, v.top.heights)
    np.testing.assert_allclose(back.container.T_world_container, T, atol=1e-12)
    np.testing.assert_array_equal(back.key_view.labels, v.key_view.labels)
    count = StackCount(412, (391, 430), 0.9, 0.33, 0.02, 1e-6, v, "e", "degraded", ("no_depth",),
                       {"gamma": 0.1})
    again = from_stack_count(through_dds(to_msg.to_stack_count(count, message)), message)
    assert (again.count, again.count_interval, again.gamma, again.status, again.reasons) == (
        412, (391, 430), 0.33, "degraded", ("no_depth",))


def test_failed_count_says_why():
    message = to_msg.failed_count("0 views", VolumeMsg(scan_id="s", error="0 views"))
    assert message.status == StackCountMsg.STATUS_ERROR and message.error == "0 views"
    assert np.isnan(message.gamma)


def test_image_bytes_are_taken_as_they_are():
    image = np.asfortranarray(np.arange(12, dtype=np.uint16).reshape(3, 4))
    message = to_msg.to_image(image, "16UC1", to_msg.to_header(0, "f"))
    assert (message.height, message.width, message.step) == (3, 4, 8)
    assert bytes(message.data) == np.ascontiguousarray(image).tobytes()


@pytest.mark.parametrize("stamp", [0, 999_999_999, 10**9, 1_700_000_000_999_999_999])
def test_stamps(stamp):
    time = to_msg.to_time(stamp)
    assert time.sec * 10**9 + time.nanosec == stamp
