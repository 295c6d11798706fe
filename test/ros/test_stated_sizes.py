# SPDX-License-Identifier: Apache-2.0
"""Messages that do not hold what they state are refused in one line, before room is made."""

import math

import numpy as np
import pytest
from kits.memory import limited_memory
from stack_counter_msgs.msg import HeightMap, PosedImage, StackVolume

from stack_counter.errors import ScanError, ViewError
from stack_counter.ros.conversions import (
    from_height_map,
    from_key_view,
    from_posed_image,
    from_stack_volume,
    to_key_view,
    to_posed_image,
)
from stack_counter.types import Intrinsics, KeyView, PartRequest, View

CAMERA = Intrinsics(6, 4, 5.0, 5.0, 3.0, 2.0)
COLOR = np.zeros((4, 6, 3), np.uint8)
VIEW = View(0, CAMERA, np.eye(4), COLOR)
KEY_VIEW = KeyView(0, CAMERA, np.eye(4), 3, labels=np.zeros((4, 6), np.uint8), color=COLOR)


def refused(error, convert, message):
    with limited_memory(), pytest.raises(error, match="expected") as caught:
        convert(message)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("convert, message", [
    (from_posed_image, to_posed_image(VIEW, "world", "scan", PartRequest())),
    (from_key_view, to_key_view(KEY_VIEW, "camera"))], ids=["posed image", "key view"])
@pytest.mark.parametrize("width", [0, 5, 60_000, 2**32 - 1])
def test_a_calibration_of_another_size_than_its_images(convert, message, width):
    message.camera_info.width = width
    assert f"expected {width}x4 as in its camera_info" in refused(ViewError, convert, message)


@pytest.mark.parametrize("step", [1, 17, 2**32 - 1])
def test_an_image_that_is_larger_than_its_data(step):
    message = to_posed_image(VIEW, "world", "scan", PartRequest())
    message.color.step = step
    refused(ViewError, from_posed_image, message)
    message.color.height = message.camera_info.height = 16_000
    refused(ViewError, from_posed_image, message)
    message.color.step = 0  # rows without padding
    refused(ViewError, from_posed_image, message)


@pytest.mark.parametrize("rows, cols, heights, pitch", [
    (2**32 - 1, 2**32 - 1, 4, 0.01), (2, 2, 3, 0.01), (1, 0, 3, 0.01), (2, 2, 4, 0.0),
    (2, 2, 4, math.nan), (2, 2, 4, math.inf), (2, 2, 4, -1.0)])
def test_a_map_without_its_cells(rows, cols, heights, pitch):
    said = refused(ScanError, from_height_map, HeightMap(
        rows=rows, cols=cols, heights=[0.0] * heights, pitch=pitch))
    assert f"{rows}x{cols} cells, {heights} heights" in said


@pytest.mark.parametrize("fields", [
    {"stack_volume": math.nan}, {"stack_volume": -1.0}, {"stack_volume": math.inf},
    {"stack_volume_std": math.nan}, {"stack_volume_std": -1e-9}])
def test_a_volume_that_is_none(fields):
    assert "expected finite numbers" in refused(ScanError, from_stack_volume,
                                                StackVolume(**fields))


def test_surfaces_on_two_grids():
    four, six = (HeightMap(rows=2, cols=n, heights=[0.0] * 2 * n, pitch=0.01) for n in (2, 3))
    assert "2x2 cells over an inner surface of 2x3" in refused(
        ScanError, from_stack_volume, StackVolume(top=four, inner=six))
    assert from_posed_image(PosedImage(pose=to_posed_image(
        VIEW, "world", "scan", PartRequest()).pose)).color is None  # no images: no sizes


@pytest.mark.parametrize("height", [2e3, -3e38])
def test_heights_that_no_camera_sees(height):
    assert "expected at most 1000 m" in refused(ScanError, from_height_map, HeightMap(
        rows=1, cols=2, heights=[height, math.nan], pitch=0.01))
