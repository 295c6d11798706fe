# SPDX-License-Identifier: Apache-2.0
"""What may be known of a part's form beside v: outer dimensions, and measures of its mesh."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum


class KnownLevel(IntEnum):
    """How much is known of a part's form."""

    VOLUME = 0
    SIZE = 1
    MESH = 2


@dataclass(frozen=True)
class MeshMeasures:
    """Measures of a part's mesh.

    Attributes:
        solidity: v over the volume of the convex hull, in (0, 1].
        surface_m2: area of the surface, m2.
        genus: number of through holes.
        gyration_m: root mean square distances of the material from its centre along the three
            principal axes, the largest first, metres.
    """

    solidity: float
    surface_m2: float
    genus: int
    gyration_m: tuple[float, float, float]


@dataclass(frozen=True)
class KnownForm:
    """What is known of a part's form.

    Attributes:
        outer_size_m: sides of the box around the part, in any order, metres; None: unknown.
        mesh: measures of its mesh; None: there is no mesh.
    """

    outer_size_m: tuple[float, float, float] | None = None
    mesh: MeshMeasures | None = None

    @property
    def level(self) -> KnownLevel:
        """How much is known; a mesh without outer dimensions counts as nothing."""
        if self.outer_size_m is None:
            return KnownLevel.VOLUME
        return KnownLevel.SIZE if self.mesh is None else KnownLevel.MESH
