# SPDX-License-Identifier: Apache-2.0
"""Makes a library of real solids for `stack-counter simulate` from a folder of meshes.

    python scripts/convert_shapes.py FOLDER TABLE.csv OUT.npz

FOLDER holds STL, OBJ, PLY, OFF, GLB or STEP files (STEP takes the extra `cad`). TABLE.csv has one
line for each, with the columns

    file         below FOLDER
    source       name of the collection; training can leave out whole sources
    licence      e.g. CC BY 4.0
    family       kind of thing within the source, e.g. Brick
    author       whom to credit; may be empty
    mm_per_unit  1 for millimetres, 1000 for STEP, which is read in metres; empty: size unknown

Bodies that touch are fused; a mesh that is not closed is replaced by its outer skin. What is then
no single closed body is refused, one line each, and so are doubles. OUT.json, beside OUT.npz,
keeps the origins.
"""

from __future__ import annotations

import csv
import sys
from pathlib import Path

import trimesh

from stack_counter.sim.shapes.extra.collection import (
    CollectedSolid,
    Origin,
    drop_doubles,
    solidify,
    write_collection,
)
from stack_counter.tasks.progress import progress


def read_solid(folder: Path, row: dict[str, str]) -> CollectedSolid:
    """Reads the mesh of a line of the table.

    Raises:
        ShapeError: it is not one closed body.
    """
    origin = Origin(Path(row["file"]).with_suffix("").as_posix(), row["source"], row["licence"],
                    row["family"], row["author"])
    mesh = trimesh.load(folder / row["file"], force="mesh", process=False)
    return solidify(mesh, origin, float(row["mm_per_unit"] or "nan"))


def main(folder: Path, table: Path, out: Path) -> None:
    """Writes the library; prints what was refused and why."""
    solids, refused = [], 0
    with open(table, newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    for row in progress(rows, "convert", "meshes"):
        try:
            solids.append(read_solid(folder, row))
        except Exception as error:  # the readers' own, of many kinds; the others go on
            refused += 1
            print(f"refused {row['file']}: {' '.join(str(error).split())}")
    kept = drop_doubles(solids)
    write_collection(out, kept)
    print(f"{len(kept)} solids, {refused} refused, {len(solids) - len(kept)} doubles, "
          f"{out.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main(*map(Path, sys.argv[1:]))
