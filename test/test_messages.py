from types import SimpleNamespace as Message

import cv2
import numpy as np
import pytest

from stack_counter import messages
from stack_counter.errors import ViewError

RANDOM = np.random.default_rng(1)


def image(pixels, encoding, big=False, padding=0):
    rows = pixels.reshape(pixels.shape[0], -1)
    rows = rows.astype(rows.dtype.newbyteorder(">")) if big else rows
    raw = rows.view(np.uint8).reshape(pixels.shape[0], -1)
    raw = np.hstack([raw, np.full((len(raw), padding), 77, np.uint8)])
    return Message(encoding=encoding, height=pixels.shape[0], width=pixels.shape[1],
                   step=raw.shape[1], is_bigendian=int(big), data=raw.tobytes())


@pytest.mark.parametrize("padding", [0, 5])
@pytest.mark.parametrize("encoding, channels, order", [
    ("rgb8", 3, [0, 1, 2]), ("bgr8", 3, [2, 1, 0]), ("rgba8", 4, [0, 1, 2]),
    ("bgra8", 4, [2, 1, 0])])
def test_colour_comes_out_as_rgb(encoding, channels, order, padding):
    pixels = RANDOM.integers(0, 255, (4, 6, channels)).astype(np.uint8)
    got = messages.color_to_array(image(pixels, encoding, padding=padding))
    np.testing.assert_array_equal(got, pixels[..., order])


def test_compressed_colour():
    pixels = RANDOM.integers(0, 255, (8, 8, 3)).astype(np.uint8)
    data = cv2.imencode(".png", pixels[..., ::-1])[1].tobytes()
    np.testing.assert_array_equal(messages.color_to_array(Message(format="png", data=data)),
                                  pixels)
    with pytest.raises(ViewError, match="bad_image"):
        messages.color_to_array(Message(format="jpeg", data=data[:20]))


@pytest.mark.parametrize("big", [False, True])
def test_depth_in_millimetres_and_metres(big):
    millimetres = np.array([[0, 500], [1234, 65535]], np.uint16)
    got = messages.depth_to_metres(image(millimetres, "16UC1", big, padding=2))
    np.testing.assert_allclose(got, [[0, 0.5], [1.234, 65.535]], rtol=1e-6)
    metres = np.array([[np.nan, 0.5], [np.inf, -1.0]], np.float32)
    got = messages.depth_to_metres(image(metres, "32FC1", big))
    np.testing.assert_array_equal(got, np.array([[0, 0.5], [0, 0]], np.float32))
    assert got.dtype == np.float32


@pytest.mark.parametrize("decode, message, reason", [
    (messages.depth_to_metres, image(np.zeros((2, 2), np.uint16), "16UC1"), "empty_depth"),
    (messages.depth_to_metres, image(np.ones((2, 2), np.uint8), "mono8"), "bad_encoding"),
    (messages.color_to_array, image(np.ones((2, 2), np.uint8), "yuv422"), "bad_encoding"),
    (messages.labels_to_array, image(np.full((2, 2), 7, np.uint8), "mono8"), "bad_labels"),
    (messages.image_to_array, Message(encoding="rgb8", height=0, width=4, step=12, data=b"",
                                      is_bigendian=0), "bad_image"),
    (messages.image_to_array, Message(encoding="rgb8", height=2, width=4, step=3, data=b"0" * 24,
                                      is_bigendian=0), "bad_image"),
    (messages.image_to_array, Message(encoding="rgb8", height=2, width=4, step=12, data=b"0",
                                      is_bigendian=0), "bad_image")])
def test_bad_images_say_what_was_seen(decode, message, reason):
    with pytest.raises(ViewError, match="expected") as caught:
        decode(message)
    assert caught.value.reason == reason


def test_pose_must_be_a_unit_quaternion():
    position = Message(x=1.0, y=2.0, z=3.0)
    T = messages.pose_to_matrix(Message(position=position,
                                        orientation=Message(x=0.0, y=0.0, z=0.0, w=1.0)))
    np.testing.assert_array_equal(T[:3, 3], [1, 2, 3])
    for w in (0.0, 0.5, float("nan")):
        with pytest.raises(ViewError, match="bad_pose"):
            messages.pose_to_matrix(Message(position=position,
                                            orientation=Message(x=0.0, y=0.0, z=0.0, w=w)))
