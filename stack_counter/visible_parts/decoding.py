# SPDX-License-Identifier: Apache-2.0
"""From the network's output for each pixel to parts: middles, and the pixels that vote for each.

A part's middle is a local maximum of the heat map (Zhou et al., "Objects as Points", 2019). Every
pixel that shows a part also says where the middle of that part lies, and belongs to the middle
found next to there (Cheng et al., "Panoptic-DeepLab", CVPR 2020).
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH

# Outputs of the network for each pixel: logits of a part that shows there, of a middle and of the
# share of the part that shows; and rows and columns to its middle, part lengths.
SHOWN, MIDDLE, SHARE, ROWS, COLS = range(5)
OUTPUTS = 5


@dataclass(frozen=True)
class DecodingSettings:
    """How middles and their pixels are found; all chosen.

    Attributes:
        least_score: of a middle that is looked at; which parts are told is said by the threshold
            of the network, which is higher.
        neighborhood_px: side of the square of which a middle is the maximum, pixels.
        least_shown: probability from which a pixel shows a part.
        reach: largest distance from the place that a pixel votes for to the middle, part lengths.
        least_px: pixels that a part has at least.
        outline_px: distance by which an outline may be simplified, pixels.
    """

    least_score: float = 0.05
    neighborhood_px: int = 5
    least_shown: float = 0.5
    reach: float = 0.75
    least_px: int = 5
    outline_px: float = 0.6


SETTINGS = DecodingSettings()


@dataclass(frozen=True, eq=False)
class PartsInMap:
    """The parts found in a stack's maps, the surest first.

    Attributes:
        numbers: (rows, cols) int32, the part that each pixel shows, 0 to k - 1; -1 where none is.
        centers: (k, 2) float64 row and column of its middle: mean of what its pixels vote for.
        shares: (k,) float64 estimated share that shows.
        scores: (k,) float64 of its middle, 0 to 1.
    """

    numbers: np.ndarray
    centers: np.ndarray
    shares: np.ndarray
    scores: np.ndarray

    def outlines(self) -> list[np.ndarray]:
        """(n, 2) float64 rows and columns around the largest piece of each part."""
        cells = np.argwhere(self.numbers >= 0)
        part = self.numbers[tuple(cells.T)]
        low = np.full((len(self.scores), 2), max(self.numbers.shape))
        high = np.zeros_like(low)
        np.minimum.at(low, part, cells)
        np.maximum.at(high, part, cells + 1)
        return [_outline(self.numbers[r0:r1, c0:c1] == i, np.array([r0, c0]))
                for i, ((r0, c0), (r1, c1)) in enumerate(zip(low, high))]


def decode_parts(output: np.ndarray, valid: np.ndarray,
                 threshold: float = SETTINGS.least_score) -> PartsInMap:
    """Finds the parts in the network's output.

    Args:
        output: (OUTPUTS, rows, cols) float32.
        valid: (rows, cols) bool, of the maps.
        threshold: least score of a part.
    """
    shown = valid & (output[SHOWN] >= _logit(SETTINGS.least_shown))
    middles, scores = _find_middles(output[MIDDLE], valid, threshold)
    # Let every pixel vote; keep the middles that enough pixels vote for.
    votes = np.stack(np.nonzero(shown)) + PIXELS_PER_LENGTH * output[[ROWS, COLS]][:, shown]
    chosen = _nearest_middles(votes, middles, valid.shape)
    pixels = np.bincount(chosen[chosen >= 0], minlength=len(middles))
    kept = pixels >= SETTINGS.least_px
    chosen = np.append(np.where(kept, np.cumsum(kept) - 1, -1), -1)[chosen]
    numbers = np.full(valid.shape, -1, np.int32)
    numbers[shown] = chosen
    # Average over the pixels of each.
    means = [np.bincount(chosen[chosen >= 0], values[chosen >= 0], np.count_nonzero(kept))
             / pixels[kept] for values in (*votes, _probability(output[SHARE][shown]))]
    return PartsInMap(numbers, np.stack(means[:2], axis=1), means[2], scores[kept])


def _outline(mask: np.ndarray, corner: np.ndarray) -> np.ndarray:
    """(n, 2) float64 rows and columns around the largest piece of a mask that lies at a corner."""
    pieces, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL,
                                 cv2.CHAIN_APPROX_NONE)
    largest = cv2.approxPolyDP(max(pieces, key=len), SETTINGS.outline_px, closed=True)
    return largest[:, 0, ::-1] + corner.astype(float)


def _find_middles(logits: np.ndarray, valid: np.ndarray, threshold: float
                  ) -> tuple[np.ndarray, np.ndarray]:
    """(k, 2) rows and columns of local maxima above the threshold, and their (k,) scores."""
    heat = np.where(valid, logits, -np.inf).astype(np.float32)
    highest = cv2.dilate(heat, np.ones((SETTINGS.neighborhood_px,) * 2, np.uint8))
    peaks = (heat == highest) & (heat >= _logit(threshold))
    _, plateaus = cv2.connectedComponents(peaks.astype(np.uint8))  # pixels as high as each other
    middles = np.argwhere(peaks)
    middles = middles[np.unique(plateaus[peaks], return_index=True)[1]]  # one of each plateau
    scores = _probability(heat[tuple(middles.T)])
    order = np.argsort(-scores, kind="stable")
    return middles[order], scores[order].astype(float)


def _nearest_middles(votes: np.ndarray, middles: np.ndarray, shape: tuple[int, ...]
                     ) -> np.ndarray:
    """(n,) number of the middle next to each of (2, n) places; -1 where none is within reach."""
    if not len(middles):
        return np.full(votes.shape[1], -1)
    # The middle next to every pixel, and how far it is.
    elsewhere = np.ones(shape, np.uint8)
    elsewhere[tuple(middles.T)] = 0
    distance, labels = cv2.distanceTransformWithLabels(
        elsewhere, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    number = np.zeros(labels.max() + 1, int)
    number[labels[tuple(middles.T)]] = np.arange(len(middles))
    row, col = np.clip(np.round(votes), 0, np.array(shape)[:, None] - 1).astype(int)
    near = distance[row, col] <= SETTINGS.reach * PIXELS_PER_LENGTH
    return np.where(near, number[labels[row, col]], -1)


def _logit(probability: float) -> float:
    return float(np.log(probability / (1 - probability)))


def _probability(logits: np.ndarray) -> np.ndarray:
    return 1 / (1 + np.exp(-np.asarray(logits, float)))
