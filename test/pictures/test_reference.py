# SPDX-License-Identifier: Apache-2.0
"""References: how their texts are read, and where pictures show markers and boards."""

import cv2
import numpy as np
import pytest
from kits.uncalibrated import cameras, marks_text, pictures_of

from stack_counter.errors import BagError, ConfigError
from stack_counter.pictures.reference import Board, MarkedPoints, Markers, parse_reference
from stack_counter.pictures.targets import find_targets

SIZES = {f"p{i}.png": (640, 480) for i in range(6)}


def test_the_three_forms_are_read():
    points = parse_reference("a.jpg:120,340 b.jpg:131.5,322 to a.jpg:900,410 c.jpg:870,402 = 0.30")
    assert isinstance(points, MarkedPoints) and points.length == 0.3
    assert points.ends == ({"a.jpg": (120, 340), "b.jpg": (131.5, 322)},
                           {"a.jpg": (900, 410), "c.jpg": (870, 402)})
    markers = parse_reference("aruco DICT_4X4_50 = 0.05")
    assert isinstance(markers, Markers) and markers.length == 0.05
    board = parse_reference("charuco DICT_5X5_100 7x5 0.022=0.030")
    assert isinstance(board, Board) and (board.columns, board.rows) == (7, 5)
    assert (board.length, board.marker_length) == (0.03, 0.022)


@pytest.mark.parametrize("text, said", [
    ("aruco DICT_4X4_50", "names no length"),
    ("a.jpg:120,340 b.jpg:210,88 = 0.30", "0 times the word 'to'"),
    ("a.jpg:1,2 b.jpg:3,4 to c.jpg:5,6 = 0.3", "second end .* in 1 pictures; expected two"),
    ("a.jpg:1,2 a.jpg:3,4 to a.jpg:5,6 b.jpg:1,2 = 0.3", "second mark in one picture"),
    ("a.jpg:1 b.jpg:3,4 to a.jpg:5,6 b.jpg:1,2 = 0.3", "'a.jpg:1' .* is no mark"),
    ("a.jpg:1.2.3,2 b.jpg:3,4 to a.jpg:5,6 b.jpg:1,2 = 0.3", "holds '1.2.3'"),
    ("a.jpg:1,2 b.jpg:3,4 to a.jpg:5,6 b.jpg:1,2 = 30cm", "length '30cm'; expected metres"),
    ("a.jpg:1,2 b.jpg:3,4 to a.jpg:5,6 b.jpg:1,2 = -1", "length '-1'"),
    ("aruco DICT_9X9 = 0.05", "dictionary 'DICT_9X9'; expected one of OpenCV's"),
    ("charuco DICT_5X5_100 7x5 0.03 = 0.022", "expected smaller markers"),
    ("container tote = 0.6", "two points of its rim"),
])
def test_what_cannot_be_read_is_named(text, said):
    with pytest.raises(ConfigError, match=said):
        parse_reference(text)


def test_marks_must_be_in_pictures_of_the_folder():
    def targets(text):
        return find_targets(parse_reference(text), SIZES, lambda name: None)

    assert len(targets("p0.png:1,2 p1.png:3,4 to p0.png:5,6 p1.png:1,2 = 0.3")[0].points) == 2
    with pytest.raises(ConfigError, match="'p0.jpg', which is no picture .* such as p0.png"):
        targets("p0.jpg:1,2 p1.png:3,4 to p0.png:5,6 p1.png:1,2 = 0.3")
    with pytest.raises(ConfigError, match=r"\(640, 2\) in p0.png, which is 640x480"):
        targets("p0.png:640,2 p1.png:3,4 to p0.png:5,6 p1.png:1,2 = 0.3")


def marker_pictures(numbers, side=0.06):
    """Pictures of markers of DICT_4X4_50 in a row, as far apart as they are large."""
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    sheet = np.full((300, 100 + 200 * len(numbers)), 255, np.uint8)
    for i, number in enumerate(numbers):
        sheet[100:200, 100 + 200 * i:200 + 200 * i] = cv2.aruco.generateImageMarker(
            dictionary, number, 100)
    rows, cols = sheet.shape
    return pictures_of(sheet, (cols * side / 100, rows * side / 100), cameras())


def test_corners_of_markers_are_found_where_they_are():
    pictures = marker_pictures([7, 3])
    targets = find_targets(parse_reference("aruco DICT_4X4_50 = 0.06"), SIZES,
                           pictures.__getitem__)
    assert [target.name for target in targets] == ["marker 3", "marker 7"]
    # The first corner of marker 7, which lies left: its upper left one.
    seen = targets[1].marks[0]
    assert len(seen) == 6
    for name, camera in cameras().items():
        text = marks_text([-0.09, 0.03, 0], {name: camera})
        x, y = (float(number) for number in text.split(":")[1].split(","))
        assert seen[name] == pytest.approx((x, y), abs=0.5)


def test_markers_that_do_not_show_and_twins_are_refused():
    reference = parse_reference("aruco DICT_4X4_50 = 0.06")
    with pytest.raises(BagError, match="0 of its markers were found"):
        find_targets(parse_reference("aruco DICT_6X6_50 = 0.06"), SIZES,
                     marker_pictures([7]).__getitem__)
    with pytest.raises(BagError, match="0 of its markers"):  # which one a mark is of is not known
        find_targets(reference, SIZES, marker_pictures([7, 7]).__getitem__)
