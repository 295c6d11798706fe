# SPDX-License-Identifier: Apache-2.0
"""A part that shows in the surface of a stack, and how it lies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True, eq=False)
class PartPose:
    """How a part lies, by its mesh.

    Attributes:
        T_world_part: (4, 4) float64 from the axes of the part's CAD file, metres.
        fit: how well the mesh explains the surface at that pose, 0 to 1: of the cells that show
            the part, and of those beside it where the mesh would show, those whose heights agree,
            each by how well.
    """

    T_world_part: np.ndarray
    fit: float


@dataclass(frozen=True, eq=False)
class VisiblePart:
    """Where one part shows from straight above, and how much of it.

    Attributes:
        position: (3,) float64 x and y of the middle of what shows of it, and the mean height of
            that; world, metres.
        outline: (k, 3) float64 polygon around the largest piece of what shows of it, at the
            height of `position`; world, metres.
        share_visible: estimated share of what it would show from above if nothing lay on it, 0
            to 1.
        score: how sure it is that a part's middle is there, 0 to 1.
        pose: how it lies; None where that was not looked for, or cannot be told.
    """

    position: np.ndarray
    outline: np.ndarray
    share_visible: float
    score: float
    pose: PartPose | None = None
