# SPDX-License-Identifier: Apache-2.0
"""Files of a few bytes that state gigabytes are refused before anything is made room for."""

import struct
import zlib

import cv2
import numpy as np
import pytest
from kits.memory import limited_memory
from kits.packed_depth import packed

from stack_counter.errors import ViewError
from stack_counter.views.decoding import color_to_array, depth_to_metres
from stack_counter.views.decoding.image_files import check_stated_size

IMAGE = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
VARIANTS = {"baseline": [], "progressive": [cv2.IMWRITE_JPEG_PROGRESSIVE, 1],
            "restarts": [cv2.IMWRITE_JPEG_RST_INTERVAL, 4]}


def png(width, height):
    """A PNG file of black 16-bit pixels that states this size and holds one row."""
    def chunk(kind, data):
        return struct.pack(">I", len(data)) + kind + data + struct.pack(
            ">I", zlib.crc32(kind + data))
    head = struct.pack(">IIBBBBB", width, height, 16, 0, 0, 0, 0)
    row = zlib.compress(b"\0" * (2 * width + 1))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", head) + chunk(b"IDAT", row) + chunk(b"IEND", b"")


def jpeg(width, height, *options):
    """A JPEG file whose frame header states this size."""
    data = bytearray(cv2.imencode(".jpg", IMAGE, options)[1].tobytes())
    at = data.index(b"\xff\xc0") + 5
    data[at:at + 4] = struct.pack(">HH", height, width)
    return bytes(data)


def rvl(width, height):
    """An RVL image of invalid pixels alone."""
    octal = oct(width * height)[2:][::-1]
    digits = [int(d) + 8 for d in octal[:-1]] + [int(octal[-1]), 0]
    digits += [0] * (-len(digits) % 8)
    words = [int("".join(f"{d:x}" for d in digits[k:k + 8]), 16) for k in range(0, len(digits), 8)]
    return struct.pack(f"<II{len(words)}I", width, height, *words)


@pytest.mark.parametrize("decode, message", [
    (color_to_array, packed(png(30_000, 30_000), "png", config=False)),
    (color_to_array, packed(jpeg(60_000, 60_000), "jpeg", config=False)),
    (color_to_array, packed(jpeg(0, 9), "jpeg", config=False)),
    (depth_to_metres, packed(png(16_000, 16_000), "16UC1; compressedDepth png")),
    (depth_to_metres, packed(png(2**31, 2**31), "16UC1; png compressed", config=False)),
    (depth_to_metres, packed(rvl(16_000, 16_000), "16UC1; compressedDepth rvl"))], ids=range(6))
def test_a_few_bytes_are_no_gigabyte(decode, message):
    with limited_memory(), pytest.raises(ViewError, match="expected") as caught:
        decode(message)
    assert caught.value.reason == "bad_image" and "\n" not in str(caught.value)


@pytest.mark.parametrize("options", VARIANTS.values(), ids=VARIANTS)
def test_every_kind_of_jpeg_says_its_size(options):
    data = cv2.imencode(".jpg", IMAGE, options)[1].tobytes()
    check_stated_size(data, "jpeg")
    exif = b"\xff\xe1" + struct.pack(">H", 302) + b"Exif\0\0" + b"\xff\xc0" * 147
    check_stated_size(data[:2] + exif + data[2:], "jpeg")
    check_stated_size(data[:2] + b"\xff\xff" + data[2:], "jpeg")  # filled up before a marker


@pytest.mark.parametrize("suffix", [".png", ".webp", ".tiff", ".bmp"])
def test_other_files_that_opencv_reads_say_it_too(suffix):
    check_stated_size(cv2.imencode(suffix, IMAGE)[1].tobytes(), suffix, 30 * 40)
    with pytest.raises(ViewError, match="40x30 pixels in"):
        check_stated_size(cv2.imencode(suffix, IMAGE)[1].tobytes(), suffix, 30 * 40 - 1)


@pytest.mark.parametrize("data", [
    b"", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"\xff\xd8\xff\xc0", b"\xff\xd8" + b"\xff" * 50,
    jpeg(40, 30)[:20]], ids=range(6))
def test_what_does_not_say_its_size_is_refused(data):
    with pytest.raises(ViewError, match="expected a JPEG or PNG image"):
        check_stated_size(data, "x")
