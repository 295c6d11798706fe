# SPDX-License-Identifier: Apache-2.0
"""Depth of single pictures, scaled view by view to what stereo measured, where stereo has none.

A network that knows depth from millions of pictures gives it up to scale and shift of its inverse;
both are fitted to the depth that stereo measured in the same view. Where the two do not agree,
nothing is filled in.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares

from stack_counter.segmentation.labels import require_labels
from stack_counter.types import BACKGROUND, View

# (h, w, 3) uint8 RGB -> (h, w) float32, affine in the inverse of depth.
Nearness = Callable[[np.ndarray], np.ndarray]


@dataclass(frozen=True)
class MonocularSettings:
    """When a view's depth is filled in; all chosen.

    Attributes:
        fewest_pixels: least number of the stack's pixels that stereo measured.
        most_fitted: largest number of them that are fitted, evenly chosen.
        agreement: relative difference of depths at which the two agree.
        min_agreeing: least share of the fitted pixels that agree.
        beyond: by how much, relatively, filled depth may lie beyond what stereo measured.
    """

    fewest_pixels: int = 500
    most_fitted: int = 5000
    agreement: float = 0.01
    min_agreeing: float = 0.5
    beyond: float = 0.02


SETTINGS = MonocularSettings()


@cache
def load_nearness(folder: Path) -> Nearness:
    """Loads Depth Anything V2 from the user's folder, once.

    Raises:
        WeightsError: it cannot be loaded.
    """
    from stack_counter.pretrained.depth_anything import MonocularDepth  # needs transformers

    return MonocularDepth(folder).estimate_nearness


def fill_depth(views: Sequence[View], nearness: Nearness) -> list[View]:
    """Fills in the depth of the stack's pixels that stereo did not measure.

    Args:
        views: with colour, labels and stereo's depth, 0 where unknown.
        nearness: of a picture.
    """
    return [_fill_view(view, nearness) for view in views]


def _fill_view(view: View, nearness: Nearness) -> View:
    s = SETTINGS
    assert view.depth is not None and view.color is not None  # stereo measured it by its colour
    stack = require_labels(view) != BACKGROUND
    measured = stack & (view.depth > 0)
    if np.count_nonzero(measured) < s.fewest_pixels:
        return view
    near = nearness(view.color)
    inverse = 1 / view.depth[measured]
    step = len(inverse) // s.most_fitted + 1
    scale, shift = _fit_affine(near[measured][::step], inverse[::step])
    difference = np.abs((scale * near[measured] + shift) / inverse - 1)
    if scale <= 0 or np.mean(difference < s.agreement) < s.min_agreeing:
        return view
    filled = scale * near + shift
    inside = (filled > inverse.min() / (1 + s.beyond)) & (filled < inverse.max() * (1 + s.beyond))
    chosen = stack & ~measured & inside
    depth = np.where(chosen, 1 / np.where(chosen, filled, 1), view.depth)
    return replace(view, depth=depth.astype(np.float32))


def _fit_affine(near: np.ndarray, inverse: np.ndarray) -> tuple[float, float]:
    """Scale and shift from (n,) nearness to inverse depths, 1/m, of which some are far off."""
    tolerance = SETTINGS.agreement * float(np.median(inverse))
    first = np.array([np.ptp(inverse) / max(float(np.ptp(near)), 1e-9), np.median(inverse)])
    first[1] -= first[0] * np.median(near)
    scale, shift = least_squares(lambda p: p[0] * near + p[1] - inverse, first, loss="cauchy",
                                 f_scale=tolerance).x
    return float(scale), float(shift)
