# SPDX-License-Identifier: Apache-2.0
"""Depth in all its packings and units, and what is refused."""

import numpy as np
import pytest
from kits import recording_kit as kit
from kits.packed_depth import inverse, packed, png, rvl

from stack_counter.errors import ViewError
from stack_counter.views.decoding import depth_to_metres
from stack_counter.views.decoding.rvl import decode_rvl

RANDOM = np.random.default_rng(3)
MILLIMETRES = np.where(RANDOM.random((23, 31)) < 0.3, 0,
                       RANDOM.integers(400, 700, (23, 31))).astype(np.uint16)
METRES = MILLIMETRES.astype(np.float32) * np.float32(0.001)


@pytest.mark.parametrize("stored", [">u2", "<u2"])
@pytest.mark.parametrize("says_big", [True, False])
def test_bytes_are_in_the_order_that_is_said_or_that_they_are_in(stored, says_big):
    smooth = (500 + 3 * np.add.outer(np.arange(40), np.arange(50))).astype(np.uint16)
    message = kit.image(smooth.astype(stored), "16UC1")
    message.is_bigendian = int(says_big)
    right = smooth if says_big or stored == "<u2" else smooth.byteswap()
    assert np.array_equal(depth_to_metres(message), right * np.float32(0.001))


def test_signed_depth_is_in_the_order_that_it_is_in_too():
    smooth = (500 + 3 * np.add.outer(np.arange(40), np.arange(50))).astype(np.int16)
    message = kit.image(smooth, "16SC1")
    message.is_bigendian = 1
    assert np.array_equal(depth_to_metres(message), smooth * np.float32(0.001))


def test_double_precision_beyond_single_is_invalid():
    message = kit.image(np.array([[0.5, np.finfo(float).max, -1.0, np.nan]]), "64FC1")
    assert depth_to_metres(message).tolist() == [[0.5, 0, 0, 0]]


def refused(message, **settings):
    with pytest.raises(ViewError) as caught:
        depth_to_metres(message, **settings)
    assert "expected" in str(caught.value) and "\n" not in str(caught.value)
    return caught.value


@pytest.mark.parametrize("image", [
    MILLIMETRES, np.zeros((5, 4), np.uint16), np.full((5, 4), 9, np.uint16),
    RANDOM.integers(0, 65536, (40, 50)).astype(np.uint16), np.eye(9, dtype=np.uint16),
    np.array([[65535, 0, 1, 65535]], np.uint16), np.array([[7]], np.uint16)], ids=range(7))
def test_rvl_round_trip(image):
    found = decode_rvl(rvl(image))
    assert found.dtype == np.uint16 and np.array_equal(found, image)


def test_rvl_by_hand():
    """2 invalid pixels, 3 valid ones: 5, 4 and 21, as numbers 2, 3, 10, 1 and 34."""
    # Nibbles 2, 3, 2 and more 1, 1, 2 and more 4; the word is filled with a 0.
    data = bytes.fromhex("05000000 01000000") + (0x23A11A40).to_bytes(4, "little")
    assert decode_rvl(data).tolist() == [[0, 0, 5, 4, 21]]


@pytest.mark.parametrize("damage", [
    lambda d: d[:-8], lambda d: d[:9], lambda d: b"", lambda d: b"\0" * 8 + d[8:],
    lambda d: d[:8] + b"\xff" * 40, lambda d: d[:8] + b"\0" * 40,
    lambda d: b"\xff" * 8 + d[8:]], ids=range(7))
def test_damaged_rvl_is_refused(damage):
    with pytest.raises(ViewError, match="RVL.*expected") as caught:
        decode_rvl(damage(rvl(MILLIMETRES)))
    assert caught.value.reason == "bad_image"


@pytest.mark.parametrize("message", [
    packed(png(MILLIMETRES), "16UC1; compressedDepth png"),
    packed(png(MILLIMETRES), "16UC1; compressedDepth"),  # older releases have no other packing
    packed(rvl(MILLIMETRES), "16UC1; compressedDepth rvl"),
    packed(png(MILLIMETRES), "16UC1; png compressed ", config=False),
    packed(png(MILLIMETRES), "png", config=False)], ids=lambda message: message.format)
def test_packed_millimetres_are_lossless(message):
    found = depth_to_metres(message)
    assert found.dtype == np.float32 and np.array_equal(found, METRES)


@pytest.mark.parametrize("pack, name", [(png, "png"), (rvl, "rvl")])
def test_quantised_metres_are_as_exact_as_the_inverse_depth(pack, name):
    quantised, parameters = inverse(np.where(METRES > 0, METRES, np.nan))
    found = depth_to_metres(packed(pack(quantised), f"32FC1; compressedDepth {name}",
                                   parameters=parameters))
    assert np.array_equal(found > 0, METRES > 0)
    assert np.abs(found - METRES).max() < METRES.max()**2 / parameters[0]


@pytest.mark.parametrize("message, reason", [
    (packed(b"", "16UC1; compressedDepth png"), "bad_image"),
    (packed(b"no picture", "16UC1; compressedDepth png"), "bad_image"),
    (packed(b"", "16UC1; compressedDepth rvl"), "bad_image"),
    (packed(png((MILLIMETRES >> 8).astype(np.uint8)), "mono8; png compressed", config=False),
     "bad_encoding"),
    (packed(png(MILLIMETRES), "32FC1; compressedDepth png"), "bad_image"),  # no parameters
    (packed(png(np.zeros((4, 4), np.uint16)), "16UC1; compressedDepth png"), "empty_depth"),
    (kit.compressed(np.zeros((4, 4, 3), np.uint8), ".jpg"), "bad_encoding")],
    ids=lambda x: x if isinstance(x, str) else "")
def test_what_is_no_depth_is_refused(message, reason):
    assert refused(message).reason == reason


@pytest.mark.parametrize("stored, encoding, scale", [
    (MILLIMETRES * 10, "16UC1", 0.0001), (MILLIMETRES * 4, "mono16", 0.00025),
    (MILLIMETRES.astype(np.float32), "32FC1", 0.001), (METRES, "32FC1", 1.0)])
def test_the_unit_may_be_set(stored, encoding, scale):
    found = depth_to_metres(kit.image(stored, encoding), scale)
    assert found.dtype == np.float32 and found == pytest.approx(METRES, rel=1e-6)


def test_metres_that_are_millimetres_are_named_with_the_setting():
    error = refused(kit.image(MILLIMETRES.astype(np.float32), "32FC1"))
    assert error.reason == "wrong_depth_unit" and "set depth_scale: 0.001" in str(error)
    assert "set depth_scale: 0.0001" in str(refused(kit.image(METRES * np.float32(1e4), "32FC1")))
    assert "set depth_scale (metres" in str(refused(kit.image(METRES * np.float32(1e7), "32FC1")))


@pytest.mark.parametrize("stored, encoding", [
    (np.full((9, 9), 65535, np.uint16), "16UC1"), (np.full((9, 9), 90, np.float32), "32FC1")])
def test_a_far_wall_is_no_wrong_unit(stored, encoding):
    assert depth_to_metres(kit.image(stored, encoding)).min() > 60
