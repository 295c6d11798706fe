# SPDX-License-Identifier: Apache-2.0
"""Joins the three origins of the unseen test set into `data/unseen/shapes.npz`.

    python scripts/join_unseen_shapes.py FOLDER

FOLDER holds what catalogue_shapes.py and package_shapes.py wrote: SOURCE/FAMILY/VARIANT.stl. The
hand-written solids come from stack_counter.sim.shapes.extra.unseen. Bodies that touch are
fused, dents and bumps below a few thousandths of the part size go, and what is then no single
watertight body is refused: one line each.
"""

from __future__ import annotations

import sys
import zlib
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import trimesh

from stack_counter.sim.shapes import FAMILIES, SIZES_M, Shape, ShapeError, shape_from_mesh
from stack_counter.sim.shapes.extra.collection import fuse_bodies
from stack_counter.sim.shapes.extra.unseen import GENERATORS, make_solid
from stack_counter.sim.shapes.library import save_shapes
from stack_counter.sim.shapes.manifolds import simplify_manifold

_OUT = Path(__file__).parent.parent / "data/unseen/shapes.npz"
# The source whose files have a real size, millimetres.
_CATALOGUE = "bd_warehouse"
_MAX_FACES = 3000  # chosen


def list_candidates(folder: Path) -> Iterator[tuple[str, str, str, Path | None]]:
    """Source, family, variant and file of each; the hand-written ones have no file."""
    for path in sorted(folder.glob("*/*/*.stl")):
        yield *path.relative_to(folder).with_suffix("").parts, path
    for family, (_, variants) in GENERATORS.items():
        for variant in range(variants):
            yield "hand_written", family, str(variant), None


def make_checked_shape(source: str, family: str, variant: str, path: Path | None) -> Shape:
    """Makes a candidate a shape of 15 to 45 mm.

    Raises:
        ShapeError: it is no single watertight body, too heavy, or of a training family.
    """
    if family in FAMILIES:
        raise ShapeError("is a training family; expected another")
    solid = fuse_bodies(trimesh.load(path, force="mesh", process=False)) if path \
        else make_solid(family, int(variant))
    coarse = simplify_manifold(solid, _MAX_FACES)
    if coarse.num_tri() > _MAX_FACES:
        raise ShapeError(f"{coarse.num_tri()} faces; expected at most {_MAX_FACES}")
    raw = coarse.to_mesh64()
    vertices = raw.vert_properties[:, :3]
    name = f"{source}/{family}/{variant}"
    size = np.random.default_rng(zlib.crc32(name.encode())).uniform(*SIZES_M)
    if source == _CATALOGUE:
        size = np.clip(np.ptp(vertices, axis=0).max() / 1000, *SIZES_M)
    return shape_from_mesh(vertices, raw.tri_verts, family, part_size=float(size))


def main(folder: Path) -> None:
    """Writes the file; prints what was refused and why."""
    kept: dict[tuple[str, str, str], Shape] = {}
    refused = 0
    for *key, path in list_candidates(folder):
        try:
            kept[tuple(key)] = make_checked_shape(*key, path)
        except ShapeError as error:
            refused += 1
            print(f"refused {'/'.join(key)}: {error}")
    shapes = list(kept.values())
    _OUT.parent.mkdir(parents=True, exist_ok=True)
    save_shapes(_OUT, shapes, names=np.array(["/".join(key) for key in kept]),
                sources=np.array([key[0] for key in kept]))
    print(f"{len(shapes)} shapes, {refused} refused, {_OUT.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
