# SPDX-License-Identifier: Apache-2.0
"""Picks objects of published packages for the unseen test set and writes them as STL files.

    pip download --no-deps -d WHEELS pybullet==3.2.7 metaworld==3.1.1
    python scripts/package_shapes.py WHEELS OUT

The wheels are only read, never installed. Of the random objects of pybullet (zlib licence) those
were chosen whose bodies touch and that look like no training family; of metaworld (MIT) the
objects and fittings that are closed solids. The files are OUT/PACKAGE/FAMILY/VARIANT.stl;
`join_unseen_shapes.py` fuses their bodies.
"""

from __future__ import annotations

import io
import sys
import zipfile
from pathlib import Path

import trimesh

_RANDOM = "pybullet_data/random_urdfs/{0}/{0}.obj"
_METAWORLD = "metaworld/assets/objects/meshes/{}.stl"

RANDOM = {  # family: numbers of the objects
    "jointed_blocks": ("054", "098", "103", "416", "592", "645", "653", "670", "725",
                       "827", "936", "946"),
    "jointed_pods": ("016", "220", "425", "557", "728", "736", "915"),
}
OBJECTS = {  # family: its mesh
    "basket_hoop": "basketball/hoop",
    "bent_handle": "thermos/therm_handle",
    "press_base": "handle_press/handle_press_base",
    "stool": "peg_block/block_outer",
}


def load_closed_bodies(wheel: zipfile.ZipFile, path: str) -> trimesh.Trimesh:
    """Loads the closed bodies of one mesh of a wheel; open ones are trim without thickness."""
    mesh = trimesh.load(io.BytesIO(wheel.read(path)), file_type=path[-3:], force="mesh")
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces)
    mesh.update_faces(mesh.nondegenerate_faces())
    return trimesh.util.concatenate(mesh.split(only_watertight=True))


def main(wheels: Path, folder: Path) -> None:
    """Writes every chosen object below the folder."""
    chosen = [("pybullet", family, number, _RANDOM.format(number))
              for family, numbers in RANDOM.items() for number in numbers]
    chosen += [("metaworld", family, "0", _METAWORLD.format(name))
               for family, name in OBJECTS.items()]
    opened = {name: zipfile.ZipFile(next(wheels.glob(f"{name}-*.whl")))
              for name in ("pybullet", "metaworld")}
    for package, family, variant, path in chosen:
        out = folder / package / family / f"{variant}.stl"
        out.parent.mkdir(parents=True, exist_ok=True)
        load_closed_bodies(opened[package], path).export(out)


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
