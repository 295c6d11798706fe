# SPDX-License-Identifier: Apache-2.0
"""Writes sparse parts, wire frames of 15 to 45 mm, as a library for `stack-counter simulate`.

    python scripts/sparse_shapes.py OUT.npz [PARTS_PER_FAMILY]

A part is refused, one line each, if it is no single watertight body, if the physics cannot split
it into few convex pieces, or if these fill much more than it does.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import trimesh

from stack_counter.sim.physics.collision import convex_pieces
from stack_counter.sim.shapes import SIZES_M, Shape, ShapeError, shape_from_mesh
from stack_counter.sim.shapes.extra.sparse import GENERATORS, make_solid
from stack_counter.sim.shapes.library import write_library

# Parts of a family; largest volume of the convex pieces over that of the part, beyond which wires
# would be too thick. Both chosen.
_PARTS, _MAX_FULLNESS = 8, 1.5


def make_checked_shape(family: str, variant: int) -> Shape:
    """Makes one part of 15 to 45 mm.

    Raises:
        ShapeError: it is no solid, or has no faithful decomposition.
    """
    raw = make_solid(family, variant).to_mesh64()
    size = float(np.random.default_rng(variant).uniform(*SIZES_M))
    # As the file will hold it: corners that are one in float32 are merged when it is read.
    vertices = raw.vert_properties[:, :3].astype(np.float32)
    shape = shape_from_mesh(vertices, raw.tri_verts, family, part_size=size)
    pieces = sum(trimesh.convex.convex_hull(corners).volume for corners in convex_pieces(shape))
    if pieces > _MAX_FULLNESS * shape.unit_volume:
        raise ShapeError(f"its convex pieces fill {pieces / shape.unit_volume:.2f} times its "
                         f"volume; expected at most {_MAX_FULLNESS}")
    return shape


def main(out: Path, parts: int = _PARTS) -> None:
    """Writes the file; prints what was refused and why."""
    write_library(out, make_checked_shape, GENERATORS, range(parts))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
