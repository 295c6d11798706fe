# SPDX-License-Identifier: Apache-2.0
"""Writes compound parts of 15 to 45 mm as a library for `stack-counter simulate`.

    python scripts/compound_shapes.py OUT.npz [PARTS_PER_FAMILY [FIRST]]

A part is refused, one line each, if it is no single watertight body, is nearly a sheet or has too
many faces.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from stack_counter.sim.shapes import SIZES_M, Shape, ShapeError, shape_from_mesh
from stack_counter.sim.shapes.extra.compound import GENERATORS, make_solid
from stack_counter.sim.shapes.library import write_library

# Parts of a family; of one part the largest number of faces, the least share of the cube of its
# size that it fills, and how far simplification may move its surface, in part sizes. All chosen.
_PARTS, _MAX_FACES, _MIN_FILL, _TOLERANCE = 30, 1500, 0.02, 0.004


def make_checked_shape(family: str, variant: int) -> Shape:
    """Makes one part of 15 to 45 mm.

    Raises:
        ShapeError: it is no solid, too thin or too rugged.
    """
    raw = make_solid(family, variant).simplify(_TOLERANCE).to_mesh64()
    size = float(np.random.default_rng(variant).uniform(*SIZES_M))
    shape = shape_from_mesh(raw.vert_properties[:, :3], raw.tri_verts, family, part_size=size)
    # As the file will hold it: corners that are one in float32 are merged when it is read.
    shape = shape_from_mesh(shape.vertices.astype(np.float32), shape.faces, family)
    fill = shape.unit_volume / size**3
    if fill < _MIN_FILL or len(shape.faces) > _MAX_FACES:
        raise ShapeError(f"fill {fill:.3f}, {len(shape.faces)} faces; expected at least "
                         f"{_MIN_FILL} and at most {_MAX_FACES}")
    return shape


def main(out: Path, parts: int = _PARTS, first: int = 0) -> None:
    """Writes the file; prints what was refused and why."""
    write_library(out, make_checked_shape, GENERATORS, range(first, first + parts))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
