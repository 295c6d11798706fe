# SPDX-License-Identifier: Apache-2.0
"""ROS messages to numpy: round trips, padding, byte order, and what is refused."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from kits import recording_kit as kit

from stack_counter import geometry
from stack_counter.errors import ViewError
from stack_counter.views import decoding

RANDOM = np.random.default_rng(1)
RGB = RANDOM.integers(0, 256, (11, 7, 3)).astype(np.uint8)
GREY = RANDOM.integers(0, 256, (11, 7)).astype(np.uint8)
MILLIMETRES = RANDOM.integers(1, 65536, (11, 7)).astype(np.uint16)


def refused(call, message):
    """The error of a message that is refused."""
    with pytest.raises(ViewError) as caught:
        call(message)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)
    return caught.value


def with_alpha(rgb):
    return np.dstack([rgb, np.full(rgb.shape[:2], 9, np.uint8)])


@pytest.mark.parametrize("encoding, stored", [
    ("rgb8", RGB), ("bgr8", RGB[..., ::-1]), ("rgba8", with_alpha(RGB)),
    ("bgra8", with_alpha(RGB[..., ::-1])),
], ids=lambda x: x if isinstance(x, str) else "")
@pytest.mark.parametrize("padding", [0, 5])
def test_colour_is_rgb_whatever_the_encoding(encoding, stored, padding):
    found = decoding.color_to_array(kit.image(stored, encoding, padding=padding))
    assert found.dtype == np.uint8 and np.array_equal(found, RGB)


@pytest.mark.parametrize("encoding", ["mono8", "8UC1"])
def test_grey_colour_has_three_equal_channels(encoding):
    found = decoding.color_to_array(kit.image(GREY, encoding, padding=1))
    assert np.array_equal(found, np.dstack([GREY] * 3))


def test_png_is_lossless():
    assert np.array_equal(decoding.color_to_array(kit.compressed(RGB, ".png")), RGB)


def test_jpeg_keeps_channels_and_brightness():
    smooth = np.zeros((64, 64, 3), np.uint8)
    smooth[..., 0], smooth[..., 1], smooth[..., 2] = 200, np.arange(64), 30
    found = decoding.color_to_array(kit.compressed(smooth, ".jpg"))
    assert np.abs(found.astype(int) - smooth).mean() < 3


def test_a_picture_s_own_turn_is_not_applied():
    """An EXIF orientation must not turn pixels away from the calibration."""
    data = cv2.imencode(".jpg", RGB.repeat(8, 0).repeat(8, 1))[1].tobytes()
    tiff = b"II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0"  # turn by 90 degrees
    exif = b"Exif\0\0" + tiff
    turned = data[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + data[2:]
    message = SimpleNamespace(format="jpeg", data=turned)
    assert decoding.color_to_array(message).shape == (88, 56, 3)


@pytest.mark.parametrize("bigendian", [False, True])
@pytest.mark.parametrize("padding", [0, 6])
@pytest.mark.parametrize("encoding", ["16UC1", "mono16"])
def test_depth_in_millimetres(encoding, padding, bigendian):
    stored = MILLIMETRES.copy()
    stored[2, 3] = 0
    found = decoding.depth_to_metres(kit.image(stored, encoding, padding=padding,
                                               bigendian=bigendian))
    assert found.dtype == np.float32 and found.dtype.isnative and found[2, 3] == 0
    assert found == pytest.approx(stored / 1000, rel=1e-6)


@pytest.mark.parametrize("bigendian", [False, True])
@pytest.mark.parametrize("padding", [0, 4, 3])
def test_depth_in_metres_has_no_invalid_values_left(padding, bigendian):
    stored = RANDOM.uniform(0.2, 3, (11, 7)).astype(np.float32)
    stored[0, :4] = np.nan, np.inf, -np.inf, -1
    found = decoding.depth_to_metres(kit.image(stored, "32FC1", padding=padding,
                                               bigendian=bigendian))
    assert found.dtype == np.float32 and found.dtype.isnative
    assert found[0, :4].tolist() == [0, 0, 0, 0]
    assert np.array_equal(found[1:], stored[1:])


@pytest.mark.parametrize("stored, encoding", [
    (np.zeros((4, 4), np.uint16), "16UC1"), (np.full((4, 4), np.nan, np.float32), "32FC1")])
def test_depth_without_a_valid_pixel_is_refused(stored, encoding):
    error = refused(decoding.depth_to_metres, kit.image(stored, encoding))
    assert error.reason == "empty_depth" and "16" in str(error)


@pytest.mark.parametrize("call, encoding", [
    (decoding.color_to_array, "yuv411"), (decoding.color_to_array, "16UC1"),
    (decoding.depth_to_metres, "rgb8"), (decoding.depth_to_metres, "32FC3"),
    (decoding.labels_to_array, "rgb8"), (decoding.labels_to_array, "32SC1"),
    (decoding.image_to_array, "8SC1"), (decoding.image_to_array, ""),
])
def test_an_unknown_encoding_is_refused_by_name(call, encoding):
    error = refused(call, kit.image(GREY, encoding))
    assert error.reason == "bad_encoding" and f"'{encoding}'" in str(error)


@pytest.mark.parametrize("change", [
    {"height": 0}, {"width": 0}, {"height": 12}, {"step": 20}, {"width": 8}, {"step": 2**31},
    {"height": 2**32 - 1}, {"width": 2**31, "step": 0}, {"data": np.zeros(0, np.uint8)},
    {"data": np.zeros(230, np.uint8)},
], ids=str)
def test_sizes_that_disagree_with_the_bytes_are_refused(change):
    error = refused(decoding.color_to_array, replace(kit.image(RGB, "rgb8"), **change))
    assert error.reason == "bad_image"


@pytest.mark.parametrize("data", [b"", b"\xff\xd8\xff", b"no picture at all", bytes(1000)])
def test_bytes_that_are_no_picture_are_refused(data):
    error = refused(decoding.color_to_array, SimpleNamespace(format="jpeg", data=data))
    assert error.reason == "bad_image" and f"{len(data)} bytes" in str(error)


def test_labels():
    stored = RANDOM.integers(0, 3, (11, 7)).astype(np.uint8)
    found = decoding.labels_to_array(kit.image(stored, "mono8", padding=1))
    assert found.dtype == np.uint8 and np.array_equal(found, stored)


@pytest.mark.parametrize("value", [3, 128, 255])
def test_other_label_values_are_refused(value):
    stored = np.zeros((4, 4), np.uint8)
    stored[1, 1] = value
    error = refused(decoding.labels_to_array, kit.image(stored, "mono8"))
    assert error.reason == "bad_labels" and str(value) in str(error)


def test_camera_info_in_both_spellings():
    given = replace(kit.SMALL, fx=150.0, fy=151.0, distortion_model="rational_polynomial",
                    distortion=tuple(0.01 * i for i in range(8)))
    message = kit.camera_info(given)
    assert decoding.intrinsics_of_camera_info(message) == given
    older = SimpleNamespace(width=given.width, height=given.height, K=message.k, D=message.d,
                            distortion_model=given.distortion_model)
    assert decoding.intrinsics_of_camera_info(older) == given


def test_rectified_images_have_the_projection_and_no_distortion():
    given = replace(kit.SMALL, distortion_model="plumb_bob", distortion=(-0.3, 0.1, 0, 0, 0))
    p = np.array([140.0, 0, 80, 0, 0, 141, 60, 0, 0, 0, 1, 0])
    message = replace(kit.camera_info(given), p=p)
    found = decoding.intrinsics_of_camera_info(message, rectified=True)
    assert found == replace(kit.SMALL, fx=140.0, fy=141.0, cx=80.0, cy=60.0)
    empty = replace(message, p=np.zeros(12))
    assert decoding.intrinsics_of_camera_info(empty, rectified=True) == given


def test_images_without_distortion_have_k_whatever_p_says():
    given = replace(kit.SMALL, distortion_model="plumb_bob", distortion=(0.0,) * 5)
    message = replace(kit.camera_info(given),
                      p=np.array([140.0, 0, 80, 0, 0, 141, 60, 0, 0, 0, 1, 0]))
    assert decoding.intrinsics_of_camera_info(message, rectified=True) == given


def test_stamps_keep_every_nanosecond():
    stamp = 1_700_000_000_123_456_789
    assert decoding.stamp_ns(kit.header(stamp).stamp) == stamp


def test_poses_and_transforms_round_trip():
    T = geometry.look_at(np.array([0.3, -0.2, 0.7]), np.array([0.0, 0.1, 0.0]))
    assert decoding.pose_to_matrix(kit.pose_stamped(0, T).pose) == pytest.approx(T, abs=1e-12)
    assert decoding.transform_to_matrix(kit.transform(0, T).transform) \
        == pytest.approx(T, abs=1e-12)


@pytest.mark.parametrize("change", [{"w": 0.0}, {"x": float("nan")}, {"w": 2.0}], ids=str)
def test_a_quaternion_that_is_no_rotation_is_refused(change):
    pose = kit.pose_stamped(0, np.eye(4)).pose
    error = refused(decoding.pose_to_matrix,
                    replace(pose, orientation=replace(pose.orientation, **change)))
    assert error.reason == "bad_pose"
