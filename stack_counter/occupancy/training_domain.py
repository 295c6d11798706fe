# SPDX-License-Identifier: Apache-2.0
"""Which stacks the network has learnt from, and how much it is to be doubted elsewhere."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.occupancy.flat_face import has_foreign_face
from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, StackMaps, surface_features
from stack_counter.types import Reason


@dataclass(frozen=True)
class DoubtSettings:
    """From when on an estimate is doubted, and how much its spread widens.

    Calibration widens as the run time does, so that its scores hold for doubted stacks too. A
    reason is given later than the spread widens: only where hardly any stack of training lies.

    Attributes:
        fewest_parts: parts of the smallest training piles.
        shallow_height: mean height, part lengths, below which parts lie scattered; chosen.
        least_width: part sizes that the container must be wide; chosen. Training's are 4 or
            more; the part size as the network estimates it is off by a tenth.
        named_width: part sizes of the container's width below which `large_part` is said.
        named_distance: distance from training, in its reach, above which `unlike_training` is
            said.
        widening: factor of the spread where there is a doubt; chosen.
        level_band: difference of heights, part lengths, within which a surface is level; chosen.
        level_share: least share of a surface that is level in layers that were laid, not poured.
        level_share_by_height: the same over the mean height in part lengths, for low stacks; 1%
            of the piles of train-shallow, -deep and -compound are more level, seen ideally.
        ordered_widening: factor of the spread for such layers: gamma may be up to 1; chosen.
    """

    fewest_parts: int = 12
    shallow_height: float = 0.35
    least_width: float = 3.5
    named_width: float = 2.75
    named_distance: float = 1.1
    widening: float = 1.5
    level_band: float = 0.12
    level_share: float = 0.35
    level_share_by_height: float = 0.7
    ordered_widening: float = 2.0


SETTINGS = DoubtSettings()


@dataclass(frozen=True, eq=False)
class TrainingDomain:
    """The distribution of the surfaces that a network has learnt from; see `surface_features`.

    Attributes:
        middle: (6,) mean of their features.
        whiten: (6, 6) matrix that whitens the features.
        reach: (1,) distance from the middle that 99 of 100 of them keep.
    """

    middle: np.ndarray
    whiten: np.ndarray
    reach: np.ndarray

    def distance(self, maps: StackMaps) -> float:
        """Mahalanobis distance of a surface's features from the middle, over the reach."""
        offset = (surface_features(maps) - self.middle) @ self.whiten
        return float(np.linalg.norm(offset) / self.reach[0])


@dataclass(frozen=True)
class Doubt:
    """What speaks against an estimate.

    Attributes:
        reasons: in words; empty if nothing does.
        widening: factor, at least 1, by which its spread grows.
    """

    reasons: tuple[Reason, ...]
    widening: float


def assess_doubt(maps: StackMaps, parts: float, part_size: float, walled: bool,
                 domain: TrainingDomain) -> Doubt:
    """Compares a stack with those that the network has learnt from.

    Args:
        maps: its surface.
        parts: estimated number of parts.
        part_size: estimated part size, part lengths.
        walled: the stack stands in a container.
        domain: what the network has learnt from.
    """
    distance = domain.distance(maps)
    width = min(maps.valid.shape) / PIXELS_PER_LENGTH / part_size if walled else np.inf
    is_shallow = maps.height[maps.valid].mean() < SETTINGS.shallow_height
    has_few = parts < SETTINGS.fewest_parts
    holds = {
        Reason.SHALLOW_STACK: is_shallow,
        Reason.FEW_PARTS: has_few,
        Reason.LARGE_PART: width < SETTINGS.named_width,
        Reason.UNLIKE_TRAINING: distance > SETTINGS.named_distance,
        Reason.ORDERED_LAYERS: lies_in_layers(maps),
        Reason.FLAT_FACE: has_foreign_face(maps),
    }
    is_doubted = is_shallow or has_few or width < SETTINGS.least_width or distance > 1
    widening = max(distance, SETTINGS.widening if is_doubted else 1.0,
                   SETTINGS.ordered_widening if holds[Reason.ORDERED_LAYERS] else 1.0)
    return Doubt(tuple(reason for reason, is_so in holds.items() if is_so), widening)


def lies_in_layers(maps: StackMaps) -> bool:
    """Whether much of a stack of two layers or more is level, as if its parts had been laid."""
    s = SETTINGS
    heights = maps.height[maps.valid]
    mean = float(heights.mean())
    if mean < 1:  # one layer of parts that lie flat is level too
        return False
    # The most frequent height, and what lies within a band around it.
    votes = np.bincount((heights / (s.level_band / 3)).astype(int))
    share = np.convolve(votes, np.ones(3), mode="same").max() / len(heights)
    return bool(share > max(s.level_share, s.level_share_by_height / mean))
