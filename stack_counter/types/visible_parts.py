# SPDX-License-Identifier: Apache-2.0
"""A part that shows in the surface of a stack."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
    """

    position: np.ndarray
    outline: np.ndarray
    share_visible: float
    score: float
