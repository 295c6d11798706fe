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
from stack_counter.sim.shapes.held_out.compound import GENERATORS, make_solid
from stack_counter.sim.shapes.library import write_library

_PARTS = 30  # of a family
_MOST_FACES = 1500
_LEAST_FILL = 0.02  # of the cube of the part size


def checked(family: str, variant: int) -> Shape:
    """One part.

    Raises:
        ShapeError: it is no solid, too thin or too rugged.
    """
    raw = make_solid(family, variant).simplify(0.004).to_mesh64()
    size = float(np.random.default_rng(variant).uniform(*SIZES_M))
    shape = shape_from_mesh(raw.vert_properties[:, :3], raw.tri_verts, family, part_size=size)
    # As the file will hold it: corners that are one in float32 are merged when it is read.
    shape = shape_from_mesh(shape.vertices.astype(np.float32), shape.faces, family)
    fill = shape.unit_volume / size**3
    if fill < _LEAST_FILL or len(shape.faces) > _MOST_FACES:
        raise ShapeError(f"fill {fill:.3f}, {len(shape.faces)} faces; expected at least "
                         f"{_LEAST_FILL} and at most {_MOST_FACES}")
    return shape


def main(out: Path, parts: int = _PARTS, first: int = 0) -> None:
    """Writes the file; says what was refused and why."""
    write_library(out, checked, GENERATORS, range(first, first + parts))


if __name__ == "__main__":
    main(Path(sys.argv[1]), *map(int, sys.argv[2:]))
