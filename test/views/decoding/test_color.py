# SPDX-License-Identifier: Apache-2.0
"""Colour in the encodings of sensor_msgs: the same picture, whatever it comes in."""

from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from kits import recording_kit as kit

from stack_counter.errors import ViewError
from stack_counter.views.decoding import assumed_channels, color_to_array

# Patches of strong and different colours: no channel can stand for another.
COLORS = [(200, 40, 90), (30, 160, 60), (70, 50, 220), (240, 230, 20), (20, 200, 210),
          (90, 90, 90)]
RGB = np.repeat(np.repeat(np.array(COLORS, np.uint8).reshape(2, 3, 3), 12, 0), 12, 1)
GREY = cv2.cvtColor(RGB, cv2.COLOR_RGB2GRAY)
MIDDLES = (np.array([6, 18])[:, None], np.array([6, 18, 30]))


def test_pixels_of_more_bits_and_channels():
    wide, alpha = RGB.astype(np.uint16) * 257, np.full((24, 36, 1), 7, np.uint16)
    for stored, encoding in [
            (wide, "rgb16"), (wide[..., ::-1], "bgr16"), (np.dstack([wide, alpha]), "rgba16"),
            (np.dstack([wide[..., ::-1], alpha]), "bgra16"), (RGB[..., ::-1], "8UC3"),
            (wide[..., ::-1], "16UC3"),
            (np.dstack([RGB[..., ::-1], alpha]).astype(np.uint8), "8UC4")]:
        for bigendian in (False, True):
            found = color_to_array(kit.image(stored, encoding, padding=2, bigendian=bigendian))
            assert found.dtype == np.uint8 and np.array_equal(found, RGB), encoding
    found = color_to_array(kit.image(GREY.astype(np.uint16) * 257, "mono16"))
    assert np.array_equal(found, np.dstack([GREY] * 3))


def mosaic(order, image):
    """What a sensor behind a Bayer filter sees; `order`: its first two rows."""
    out = np.zeros(image.shape[:2], image.dtype)
    for place, name in enumerate(order):
        row, column = divmod(place, 2)
        out[row::2, column::2] = image[row::2, column::2, "rgb".index(name)]
    return out


@pytest.mark.parametrize("bits, factor, kind", [(8, 1, np.uint8), (16, 257, np.uint16)])
@pytest.mark.parametrize("order", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_mosaics(order, bits, factor, kind):
    image = kit.image(mosaic(order, RGB.astype(kind) * kind(factor)), f"bayer_{order}{bits}")
    found = color_to_array(image)
    assert found.shape == RGB.shape and np.array_equal(found[MIDDLES], RGB[MIDDLES])


def test_a_mosaic_may_be_compressed():
    data = cv2.imencode(".png", mosaic("grbg", RGB))[1].tobytes()
    found = color_to_array(SimpleNamespace(format="bayer_grbg8; png compressed ", data=data))
    assert np.array_equal(found[MIDDLES], RGB[MIDDLES])
    three = cv2.imencode(".png", RGB[..., ::-1])[1].tobytes()
    found = color_to_array(SimpleNamespace(format="bayer_grbg8; png compressed bgr8", data=three))
    assert np.array_equal(found, RGB)


def studio_yuv():
    """(h, w) Y, U and V of the picture, of BT.601's studio range: by its own numbers."""
    r, g, b = (RGB[..., i].astype(float) for i in range(3))
    return (np.round(16 + 0.257 * r + 0.504 * g + 0.098 * b).astype(np.uint8),
            np.round(128 - 0.148 * r - 0.291 * g + 0.439 * b).astype(np.uint8),
            np.round(128 + 0.439 * r - 0.368 * g - 0.071 * b).astype(np.uint8))


def packed_yuv(first):
    """(h, w, 2); `first`: whether brightness comes before colour."""
    y, u, v = studio_yuv()
    color = np.where(np.arange(36) % 2, v, u)
    return np.dstack([y, color] if first else [color, y])


def planar_yuv(first, second):
    """(h * 3 / 2, w) of brightness, and below it two colours in turn."""
    half = np.stack([plane[::2, ::2] for plane in (first, second)], -1).reshape(12, 36)
    return np.vstack([studio_yuv()[0], half])


@pytest.mark.parametrize("encoding, stored", [
    ("yuv422", packed_yuv(False)), ("uyvy", packed_yuv(False)),
    ("yuv422_yuy2", packed_yuv(True)), ("yuyv", packed_yuv(True)),
    ("nv12", planar_yuv(*studio_yuv()[1:])), ("nv21", planar_yuv(*studio_yuv()[:0:-1]))],
    ids=lambda x: x if isinstance(x, str) else "")
@pytest.mark.parametrize("padding", [0, 4])
def test_brightness_and_colour_apart(encoding, stored, padding):
    message = kit.image(stored, encoding, padding=padding)
    message.height = 24
    found = color_to_array(message)
    assert found.shape == RGB.shape and np.abs(found.astype(int) - RGB)[MIDDLES].max() < 6


@pytest.mark.parametrize("encoding, width, height", [
    ("yuyv", 7, 4), ("nv12", 6, 3), ("nv12", 7, 4), ("nv21", 6, 4)])
def test_sizes_that_cannot_be_are_refused(encoding, width, height):
    message = kit.image(np.zeros((height, width), np.uint8), encoding)
    with pytest.raises(ViewError, match=f"{width}x{height} {encoding}.*expected") as caught:
        color_to_array(message)
    assert caught.value.reason == "bad_image"


def test_an_order_of_channels_that_is_assumed_is_said():
    assert assumed_channels(kit.image(RGB, "8UC3")).endswith("read as BGR")
    assert assumed_channels(kit.image(RGB, "rgb8")) == ""
    assert assumed_channels(kit.compressed(RGB)) == ""
