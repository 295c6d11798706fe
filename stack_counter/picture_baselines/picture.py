# SPDX-License-Identifier: Apache-2.0
"""What a baseline is shown, and what it offers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple, Protocol

import cv2
import numpy as np

# Mean and standard deviation of ImageNet's colours, with which most encoders were trained.
IMAGENET_MEAN = np.array([0.485, 0.456, 0.406])
IMAGENET_STD = np.array([0.229, 0.224, 0.225])


@dataclass(frozen=True, eq=False)
class Picture:
    """The colour key view of a scan, cropped to its parts.

    Attributes:
        scene: name, by which people's guesses are found.
        color: (h, w, 3) uint8 RGB.
        part: what one part is called in plain English.
        exemplars: (k, 4) float64 x0, y0, x1, y1, pixels: boxes around some parts that show well,
            as a user would draw them.
    """

    scene: str
    color: np.ndarray
    part: str
    exemplars: np.ndarray


class PictureBaseline(Protocol):
    """Guesses from one picture."""

    def guess(self, picture: Picture) -> list[float]:
        """Guesses the number of parts, or gamma; several where several people were asked.

        Returns:
            The guesses; none where there is no answer.
        """
        ...


class SquarePicture(NamedTuple):
    """A picture brought into a square, its proportions kept.

    Attributes:
        color: (side, side, 3) uint8 RGB, black beside the picture.
        scale: by which pixels of the picture were multiplied.
        offset: (2,) x, y of the picture's first pixel in the square.
    """

    color: np.ndarray
    scale: float
    offset: np.ndarray

    def moved(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) x, y in the square of points in the picture, pixel centres at whole numbers."""
        return (points + 0.5) * self.scale - 0.5 + self.offset


def fit_square(color: np.ndarray, side: int) -> SquarePicture:
    """Scales a (h, w, 3) picture so that it just fits into the middle of a square."""
    scale = side / max(color.shape[:2])
    height, width = (min(max(round(n * scale), 1), side) for n in color.shape[:2])
    resized = cv2.resize(color, (width, height), interpolation=cv2.INTER_AREA if scale < 1
                         else cv2.INTER_LINEAR)
    square = np.zeros((side, side, 3), np.uint8)
    x, y = (side - width) // 2, (side - height) // 2
    square[y:y + height, x:x + width] = resized
    return SquarePicture(square, scale, np.array([x, y], float))


def normalized(color: np.ndarray, mean: np.ndarray = IMAGENET_MEAN,
               std: np.ndarray = IMAGENET_STD) -> np.ndarray:
    """(..., 3, h, w) float32 of (..., h, w, 3) uint8 colours, as encoders read them."""
    return np.moveaxis((color / 255 - mean) / std, -1, -3).astype(np.float32)
