# SPDX-License-Identifier: Apache-2.0
"""A scan that was made hard on purpose, and its truth."""

from __future__ import annotations

from dataclasses import dataclass

from stack_counter.config import ReconstructorConfig
from stack_counter.types import View


@dataclass(frozen=True, eq=False)
class HardScan:
    """What a cell would give to the counter, and what a person would count there.

    Attributes:
        what: what was made hard, in words.
        views: with noisy depth and the poses that the robot reports, some of them wrong.
        unit_volume: volume of one part, m3.
        count: parts that are asked for: those of the region of interest if there is one, else all
            in sight.
        config: settings as the user has them, some of them wrong.
    """

    what: str
    views: list[View]
    unit_volume: float
    count: int
    config: ReconstructorConfig = ReconstructorConfig()
