# SPDX-License-Identifier: Apache-2.0
"""Where the pictures show a reference: points whose distances are known, with their pixels."""

from __future__ import annotations

import difflib
from collections import Counter, defaultdict
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.errors import BagError, ConfigError
from stack_counter.pictures.reference import Board, MarkedPoints, Markers, Reference
from stack_counter.tasks.progress import progress


@dataclass(frozen=True)
class TargetSettings:
    """How exactly marks and markers are found.

    Attributes:
        marked_std_px: standard deviation of a point that a person marks, pixels, at least; chosen.
        found_std_px: standard deviation of a corner that is detected, pixels, at least; chosen.
        inset_px: distance by which all corners of a marker are found too far inside, pixels:
            0.10 to 0.15 on rendered markers with sides of 30 to 96 pixels, 0.27 at 15.
        window: half the side of the window in which a marker's corner is refined, sides of a
            marker's cells: on the same, 0.3 (OpenCV's own) doubles the distance.
    """

    marked_std_px: float = 1.0
    found_std_px: float = 0.3
    inset_px: float = 0.15
    window: float = 0.8


SETTINGS = TargetSettings()


@dataclass(frozen=True, eq=False)
class RigidTarget:
    """Points whose distances are known, and where the pictures show them.

    Attributes:
        name: for people.
        points: (n, 3) metres, in a frame of its own.
        marks: for each point, its pixel (x, y) by picture name.
        pixel_std: standard deviation of a mark, pixels, at least.
        size_std: relative standard deviation of its size that all its marks share.
    """

    name: str
    points: np.ndarray
    marks: list[dict[str, tuple[float, float]]]
    pixel_std: float
    size_std: float = 0.0


def find_targets(reference: Reference, sizes: Mapping[str, tuple[int, int]],
                 read_gray: Callable[[str], np.ndarray]) -> list[RigidTarget]:
    """Finds where the pictures show a reference.

    Args:
        reference: as parsed.
        sizes: width and height of the upright pictures by name, pixels.
        read_gray: gives the (h, w) uint8 grey picture of a name.

    Raises:
        ConfigError: a mark is in no picture.
        BagError: no marker shows in two pictures.
    """
    if isinstance(reference, MarkedPoints):
        return [_marked_target(reference, sizes)]
    seen: dict[int, dict[str, np.ndarray]] = defaultdict(dict)  # corners (n, 2) by id and picture
    find = _marker_finder(reference) if isinstance(reference, Markers) else _corner_finder(
        reference)
    for name in progress(list(sizes), "markers", "pictures"):
        for number, corners in find(read_gray(name)).items():
            seen[number][name] = corners
    shared = {number: by_name for number, by_name in seen.items() if len(by_name) >= 2}
    targets = _marker_targets(reference, shared) if isinstance(reference, Markers) \
        else _board_target(reference, shared)
    if not targets:
        raise BagError(f"reference '{reference.text}': {len(seen)} of its "
                       f"{'markers' if isinstance(reference, Markers) else 'inner corners'} were "
                       f"found in the pictures, {len(shared)} of them in two or more; expected "
                       "the whole of it, sharp and flat, in several pictures: check the "
                       "dictionary and the board's size, or mark two points")
    return targets


def _marked_target(reference: MarkedPoints, sizes: Mapping[str, tuple[int, int]]) -> RigidTarget:
    """Raises ConfigError: a mark is in no picture."""
    for name, (x, y) in (item for end in reference.ends for item in end.items()):
        if name not in sizes:
            near = difflib.get_close_matches(name, sizes, 3) or sorted(sizes)[:3]
            raise ConfigError(f"reference '{reference.text}' marks '{name}', which is no picture "
                              f"of the folder; expected a name such as {', '.join(near)}")
        width, height = sizes[name]
        if not (0 <= x <= width - 1 and 0 <= y <= height - 1):
            raise ConfigError(f"reference '{reference.text}' marks ({x:g}, {y:g}) in {name}, "
                              f"which is {width}x{height} upright; expected a pixel inside")
    points = np.array([[0.0, 0, 0], [reference.length, 0, 0]])
    return RigidTarget("the marked points", points, list(reference.ends), SETTINGS.marked_std_px)


def _marker_finder(reference: Markers) -> Callable[[np.ndarray], dict[int, np.ndarray]]:
    """Gives what finds markers in a grey picture: corners (4, 2), pixels, by the marker's id."""
    parameters = cv2.aruco.DetectorParameters()
    parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    parameters.relativeCornerRefinmentWinSize = SETTINGS.window
    detector = cv2.aruco.ArucoDetector(_dictionary(reference.dictionary), parameters)

    def find(gray: np.ndarray) -> dict[int, np.ndarray]:
        corners, ids, _ = detector.detectMarkers(gray)
        numbers = [] if ids is None else [int(number) for number in ids.ravel()]
        once = Counter(numbers)  # two alike cannot be told apart
        return {number: quad.reshape(4, 2) for number, quad in zip(numbers, corners)
                if once[number] == 1}

    return find


def _corner_finder(reference: Board) -> Callable[[np.ndarray], dict[int, np.ndarray]]:
    """Gives what finds a board's inner corners in a grey picture: (1, 2), pixels, by id."""
    detector = cv2.aruco.CharucoDetector(_board(reference))

    def find(gray: np.ndarray) -> dict[int, np.ndarray]:
        corners, ids, _, _ = detector.detectBoard(gray)
        if ids is None:
            return {}
        return {int(number): corner.reshape(1, 2) for number, corner in zip(ids.ravel(), corners)}

    return find


def _marker_targets(reference: Markers, seen: Mapping[int, Mapping[str, np.ndarray]]
                    ) -> list[RigidTarget]:
    square = reference.length * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
    targets = []
    for number, by_name in sorted(seen.items()):
        quads = np.array(list(by_name.values()))
        reach = np.linalg.norm(quads - quads.mean(axis=1, keepdims=True), axis=-1).mean()
        targets.append(RigidTarget(
            f"marker {number}", square,
            [{name: _pixel(corners[i]) for name, corners in by_name.items()} for i in range(4)],
            SETTINGS.found_std_px, SETTINGS.inset_px / float(reach)))
    return targets


def _board_target(reference: Board, seen: Mapping[int, Mapping[str, np.ndarray]]
                  ) -> list[RigidTarget]:
    if len(seen) < 2:
        return []
    corners = np.asarray(_board(reference).getChessboardCorners(), float)
    return [RigidTarget("the board", corners[sorted(seen)], [
        {name: _pixel(found[0]) for name, found in seen[number].items()}
        for number in sorted(seen)], SETTINGS.found_std_px)]


def _pixel(corner: np.ndarray) -> tuple[float, float]:
    return float(corner[0]), float(corner[1])


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _board(reference: Board) -> cv2.aruco.CharucoBoard:
    return cv2.aruco.CharucoBoard((reference.columns, reference.rows), reference.length,
                                  reference.marker_length, _dictionary(reference.dictionary))
