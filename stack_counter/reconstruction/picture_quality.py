# SPDX-License-Identifier: Apache-2.0
"""Whether pictures without depth show a stack well enough: resolution, sharpness, exposure."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter.segmentation.labels import require_labels
from stack_counter.types import PARTS, Reason, View
from stack_counter.views.checkup.pictures import PictureStatistics, median


@dataclass(frozen=True)
class PictureQualitySettings:
    """What pictures must show of a stack.

    Attributes:
        most_views: number of views whose colours are looked at, spread over the scan; chosen.
        min_part_px: least diameter of a ball of a part's volume in the best view, pixels: a part's
            largest side is 1.7 times that (median of 600 scenes of data/train-deep), and 12
            pixels of it are needed (chosen).
        min_sharp_share: least share that is sharp of what a picture shows, in the median; as of
            `stack-counter doctor`. The pictures of a real bag of noodles are sharp on 0.97 or
            more, rendered ones that are smoothed by 4 pixels on 0.2 or less.
        white_level: grey level from which on a pixel is white; chosen.
        max_white_share: largest share of the parts' pixels that is white, in the median; chosen.
            Of a shiny bag of noodles 0.05 are.
    """

    most_views: int = 12
    min_part_px: float = 7.0
    min_sharp_share: float = 0.3
    white_level: int = 250
    max_white_share: float = 0.2


SETTINGS = PictureQualitySettings()


def picture_doubts(views: list[View], middle: np.ndarray, unit_volume: float
                   ) -> tuple[Reason, ...]:
    """Names what keeps pictures from showing the surface of a stack.

    Args:
        views: pinhole views with labels, and with colour where there is any.
        middle: (3,) of the stack, metres, world.
        unit_volume: v, m3; 0 where it is not known: then the resolution is not judged.

    Raises:
        ViewError: reason `no_labels`, if a view lacks them.
    """
    # Look at the colours of some views.
    statistics, white = PictureStatistics(), []
    for view in views[::-(-len(views) // SETTINGS.most_views)]:
        parts = require_labels(view) == PARTS
        if view.color is not None and parts.any():
            statistics.add_color(view.color)
            grey = cv2.cvtColor(view.color, cv2.COLOR_RGB2GRAY)
            white.append(float(np.mean(grey[parts] >= SETTINGS.white_level)))
    # Compare them, and the size of a part in the best view, with what is needed.
    diameter = (6 * unit_volume / np.pi) ** (1 / 3)
    part_px = diameter * max(pixels_per_metre(view, middle) for view in views)
    holds = {
        Reason.LOW_RESOLUTION: 0 < part_px < SETTINGS.min_part_px,
        Reason.BLURRED_PICTURES: median(statistics.sharp) < SETTINGS.min_sharp_share,
        Reason.OVEREXPOSED: median(white) > SETTINGS.max_white_share,
    }
    return tuple(reason for reason, is_so in holds.items() if is_so)


def pixels_per_metre(view: View, point: np.ndarray) -> float:
    """Pixels that a metre across spans at a (3,) point, metres, world, in a pinhole view."""
    return view.intrinsics.fx / float(np.linalg.norm(point - view.T_world_camera[:3, 3]))
