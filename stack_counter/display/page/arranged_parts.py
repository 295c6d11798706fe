# SPDX-License-Identifier: Apache-2.0
"""The parts of a plausible arrangement as one mesh, each part in a colour of its own."""

from __future__ import annotations

import colorsys
from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.display.mesh_decimation import decimate
from stack_counter.types import Arrangement, Mesh


@dataclass(frozen=True)
class ArrangedPartsSettings:
    """How parts that nobody has seen are shown; all chosen.

    Attributes:
        max_triangles: of all parts together, so that the page stays below 6 MB; parts of more
            are blurred.
        saturation, value: of the colours: pale, as none is the parts' own.
        hue_step: turn of the hue from part to part: the golden ratio sets neighbours apart.
    """

    max_triangles: int = 60_000
    saturation: float = 0.35
    value: float = 0.95
    hue_step: float = 0.618


SETTINGS = ArrangedPartsSettings()


def arrangement_to_show(arrangement: Arrangement) -> Mesh | None:
    """Returns the parts below the surface in the world, with colours; None where there is none."""
    count = len(arrangement.T_world_parts)
    if not count:
        return None
    part = decimate(arrangement.part, SETTINGS.max_triangles // count)
    size = len(part.vertices)
    vertices = [geometry.apply(T, part.vertices.astype(float)) for T in arrangement.T_world_parts]
    triangles = part.triangles[None] + size * np.arange(count)[:, None, None]
    colors = [colorsys.hsv_to_rgb(SETTINGS.hue_step * index % 1, SETTINGS.saturation,
                                  SETTINGS.value) for index in range(count)]
    return Mesh(np.concatenate(vertices).astype(np.float32),
                triangles.reshape(-1, 3).astype(np.int32),
                np.repeat(np.round(255 * np.array(colors)).astype(np.uint8), size, axis=0))


def arrangement_text(arrangement: Arrangement) -> str:
    """Returns what the arrangement is, in one sentence."""
    return (f"One plausible arrangement, not seen: {len(arrangement.T_world_parts)} of the "
            f"{arrangement.pile_count} parts of a simulated pile, those that lie below the "
            f"measured surface. It is the nearest of {arrangement.piles_compared} piles, off by "
            f"{1000 * arrangement.height_difference_m:.1f} mm of height in the mean.")
