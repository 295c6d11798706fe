# SPDX-License-Identifier: Apache-2.0
"""What gives pictures their scale: the text of a `--reference`.

    "a.jpg:120,340 b.jpg:131,322 to a.jpg:900,410 c.jpg:870,402 = 0.30"   two marked points
    "aruco DICT_4X4_50 = 0.05"                 all ArUco markers that show, by their side
    "charuco DICT_5X5_100 7x5 0.022 = 0.030"   a board: columns x rows, marker's and square's side

All lengths are metres. A point is marked where it shows, in two pictures or more.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import cv2

from stack_counter.errors import ConfigError

FORMS = ("'A.jpg:x,y B.jpg:x,y to A.jpg:x,y B.jpg:x,y = METRES' (two points, each marked in two "
         "or more pictures), 'aruco DICT_4X4_50 = SIDE' or "
         "'charuco DICT_5X5_100 COLUMNSxROWS MARKER_SIDE = SQUARE_SIDE'")
_MARK = re.compile(r"(?P<name>\S+):(?P<x>-?[\d.]+),(?P<y>-?[\d.]+)")


@dataclass(frozen=True)
class MarkedPoints:
    """Two points at a known distance; `ends` holds the pixel of each by picture name."""

    text: str
    length: float
    ends: tuple[dict[str, tuple[float, float]], dict[str, tuple[float, float]]]


@dataclass(frozen=True)
class Markers:
    """ArUco markers; `length`: their side."""

    text: str
    length: float
    dictionary: str


@dataclass(frozen=True)
class Board:
    """A ChArUco board; `length`: side of a square, `marker_length` of a marker, metres."""

    text: str
    length: float
    dictionary: str
    columns: int
    rows: int
    marker_length: float


Reference = MarkedPoints | Markers | Board


def parse_reference(text: str) -> Reference:
    """Reads the text of a reference.

    Raises:
        ConfigError: it has none of the three forms, or a length that is none.
    """
    left, equals, right = text.rpartition("=")
    words = left.split()
    if not equals or not words:
        raise ConfigError(f"reference '{text}' names no length; expected {FORMS}")
    if words[0] == "container":
        raise ConfigError(
            f"reference '{text}' is a container, whose size would be known only from pictures "
            "that have a scale; expected two points of its rim, marked in two or more pictures "
            "each: 'A.jpg:x,y B.jpg:x,y to A.jpg:x,y B.jpg:x,y = METRES'")
    length = _parse_length(text, right)
    if words[0] == "aruco" and len(words) == 2:
        return Markers(text, length, _check_dictionary(text, words[1]))
    if words[0] == "charuco" and len(words) == 4 and (
            size := re.fullmatch(r"(\d+)x(\d+)", words[2])):
        marker_length = _parse_length(text, words[3])
        columns, rows = int(size[1]), int(size[2])
        if marker_length >= length or min(columns, rows) < 2:
            raise ConfigError(f"reference '{text}' has markers of {marker_length} m on {columns}x"
                              f"{rows} squares of {length} m; expected smaller markers, and 2x2 "
                              "squares or more")
        return Board(text, length, _check_dictionary(text, words[1]), columns, rows,
                     marker_length)
    return _parse_points(text, words, length)


def _parse_length(text: str, number: str) -> float:
    """Raises ConfigError: it is no length in metres."""
    try:
        length = float(number)
    except ValueError:
        length = 0.0
    if not 0 < length < float("inf"):
        raise ConfigError(f"reference '{text}' has the length '{number.strip()}'; expected metres "
                          "above 0, as a number alone")
    return length


def _check_dictionary(text: str, name: str) -> str:
    """Raises ConfigError: OpenCV has no such dictionary of markers."""
    if not name.startswith("DICT_") or not hasattr(cv2.aruco, name):
        raise ConfigError(f"reference '{text}' names the dictionary '{name}'; expected one of "
                          "OpenCV's, e.g. DICT_4X4_50, DICT_5X5_100, DICT_APRILTAG_36h11")
    return name


def _parse_points(text: str, words: list[str], length: float) -> MarkedPoints:
    """Raises ConfigError: the words are not two ends with their marks."""
    if words.count("to") != 1:
        raise ConfigError(f"reference '{text}' has {words.count('to')} times the word 'to' "
                          f"between the ends of its length; expected {FORMS}")
    split = words.index("to")
    ends = []
    for which, marked in (("first", words[:split]), ("second", words[split + 1:])):
        marks: dict[str, tuple[float, float]] = {}
        for word in marked:
            match = _MARK.fullmatch(word)
            if not match or match["name"] in marks:
                raise ConfigError(f"'{word}' of the {which} end of reference '{text}' "
                                  + ("is a second mark in one picture" if match else
                                     "is no mark") + "; expected PICTURE:x,y, pixels, once for "
                                  "each picture")
            marks[match["name"]] = (_parse_pixel(word, match["x"]), _parse_pixel(word, match["y"]))
        if len(marks) < 2:
            raise ConfigError(f"the {which} end of reference '{text}' is marked in {len(marks)} "
                              "pictures; expected two or more, taken from apart")
        ends.append(marks)
    return MarkedPoints(text, length, (ends[0], ends[1]))


def _parse_pixel(word: str, number: str) -> float:
    """Raises ConfigError: it is no number."""
    try:
        return float(number)
    except ValueError as error:
        raise ConfigError(f"'{word}' holds '{number}'; expected a pixel's number") from error
