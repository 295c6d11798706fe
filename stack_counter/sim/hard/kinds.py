# SPDX-License-Identifier: Apache-2.0
"""The kinds of hard scans, and one scan of them by its number."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from stack_counter.sim.hard.bins import (
    make_given_wrongly,
    make_neighbours,
    make_raised,
    make_sunk,
)
from stack_counter.sim.hard.cameras import make_arm_in_view, make_view_short, make_views_swapped
from stack_counter.sim.hard.contents import make_covered, make_few_large, make_no_bin
from stack_counter.sim.hard.regions import make_no_plane, make_region_aside
from stack_counter.sim.hard.scan import HardScan
from stack_counter.sim.scenes.scene import Scene

HARD_KINDS: dict[str, Callable[[Scene, np.random.Generator], HardScan]] = {
    "neighbours": make_neighbours,
    "raised": make_raised,
    "given wrongly": make_given_wrongly,
    "region aside": make_region_aside,
    "no plane": make_no_plane,
    "one view short": make_view_short,
    "views swapped": make_views_swapped,
    "arm in view": make_arm_in_view,
    "few large parts": make_few_large,
    "no bin": make_no_bin,
    "sunk": make_sunk,
    "covered": make_covered,
}


def hard_kind(number: int) -> str:
    """The kind of scan `number`: all kinds in turn."""
    return list(HARD_KINDS)[number % len(HARD_KINDS)]


def make_hard_scan(seed: int, number: int, piles: list[Scene]) -> HardScan:
    """Makes a scan of one of the piles; it depends on the seed, its number and the piles alone."""
    random = np.random.default_rng([seed, number, 0x4A6D])
    pile = piles[random.integers(len(piles))]
    return HARD_KINDS[hard_kind(number)](pile, random)
