# SPDX-License-Identifier: Apache-2.0
"""The last steps of the method, from V to the count: all that the node `counter` takes of it.

They stand apart from `pipeline` as they need nothing that reconstructs, Open3D least of all.
"""

from __future__ import annotations

import time
from dataclasses import replace

from stack_counter.counting import make_count
from stack_counter.occupancy import OccupancyEstimator
from stack_counter.parts.catalogue import Part
from stack_counter.parts.informed_gamma import estimate_occupancy
from stack_counter.types import Mesh, StackCount, StackVolume, VisiblePart
from stack_counter.visible_parts.finder import VisiblePartFinder
from stack_counter.weighing.joined_count import Weighing, use_weight


def count_stack(volume: StackVolume, part: Part, estimator: OccupancyEstimator,
                confidence: float, weighing: Weighing | None = None,
                finder: VisiblePartFinder | None = None) -> StackCount:
    """Estimates gamma, joined with what is known of the part, and counts.

    Args:
        volume: of the stack.
        part: what is in it.
        estimator: of gamma.
        confidence: of the interval.
        weighing: of the stack; None where there is no scale.
        finder: of the parts that show; None where they are not looked for.

    Raises:
        ScanError: there is nothing to read gamma from.
        PartError: the part's volume is no positive number, or its mesh, which poses are found
            by, cannot be read.
    """
    begin = time.perf_counter()
    estimate = estimate_occupancy(volume, part, estimator)  # 7. gamma.
    count = make_count(volume, part.unit_volume, estimate, confidence)  # 8. gamma * V / v.
    count = use_weight(count, weighing, part.piece_weight)  # 9. What the scale says.
    counted = time.perf_counter()
    seconds = {**volume.seconds, "gamma": counted - begin}
    if finder is not None:  # 10. The parts that show, one by one: in an empty bin there are none.
        visible = _find_visible(finder, volume, part) if count.count else ()
        seconds["visible_parts"] = time.perf_counter() - counted
        count = replace(count, visible_parts=visible)
    return replace(count, seconds=seconds)


def _find_visible(finder: VisiblePartFinder, volume: StackVolume, part: Part
                  ) -> tuple[VisiblePart, ...] | None:
    """Finds the parts that show, with poses where they are wanted and the part has a mesh."""
    mesh: Mesh | None = None
    if finder.poses and part.mesh is not None:
        # It loads trimesh and SciPy, which a count needs nothing of.
        from stack_counter.parts.part_solid import read_part_surface

        mesh = read_part_surface(part)
    return finder.find(volume, part.unit_volume, mesh)
