# SPDX-License-Identifier: Apache-2.0
"""How the parts that no view shows may lie."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.types.shapes import Mesh


@dataclass(frozen=True, eq=False)
class Arrangement:
    """Parts of a simulated pile that lie below a measured surface: plausible, not seen.

    Attributes:
        part: one part in its own frame.
        T_world_parts: (n, 4, 4) float64 poses of the parts below the surface.
        pile_count: number of parts in the whole pile; those that would stand out of the measured
            surface are not among the n.
        height_difference_m: mean absolute difference between the pile's top surface and the
            measured one, metres.
        piles_compared: number of simulated piles of which this is the nearest.
    """

    part: Mesh
    T_world_parts: np.ndarray
    pile_count: int
    height_difference_m: float
    piles_compared: int
