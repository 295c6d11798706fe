# SPDX-License-Identifier: Apache-2.0
"""How finely the pixels of views sample what they show."""

from __future__ import annotations

import numpy as np

from stack_counter.types import View


def pixel_spacing(views: list[View], point: np.ndarray) -> float:
    """Length, metres, that a pixel spans at a (3,) point, world, in the median of the views."""
    distances = [np.linalg.norm(view.T_world_camera[:3, 3] - point) for view in views]
    return float(np.median([d / view.intrinsics.fx for d, view in zip(distances, views)]))
