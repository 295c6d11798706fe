# SPDX-License-Identifier: Apache-2.0
"""Writes catalogue fasteners and bearings of the unseen test set as STL files, in millimetres.

Runs in an environment of its own, as its CAD kernel clashes with this project's packages:

    python3 -m venv cad && cad/bin/pip install bd_warehouse==0.4.0 build123d==0.13.0
    cad/bin/python scripts/catalogue_shapes.py OUT

The files are OUT/bd_warehouse/FAMILY/VARIANT.stl; `join_unseen_shapes.py` fuses their bodies.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from bd_warehouse import bearing, fastener
from bd_warehouse.open_builds import TNut
from build123d import Compound, Cylinder, Pos, Shape, export_stl

# Deviations of the triangles, mm off the surface and rad to the next: of fasteners, of bearings.
_FINE, _COARSE = (0.1, 0.4), (0.2, 0.5)

SCREWS = {  # family: class, standard, then size and length of each
    "hex_bolt": ("HexHeadScrew", "iso4017", [("M8-1.25", 16), ("M12-1.75", 30), ("M16-2", 25)]),
    "flange_bolt": ("HexHeadWithFlangeScrew", "din1665", [("M10-1.5", 20), ("M12-1.75", 20)]),
    "socket_head_cap_screw": ("SocketHeadCapScrew", "iso4762",
                              [("M8-1.25", 12), ("M10-1.5", 16)]),
    "countersunk_screw": ("CounterSunkScrew", "iso10642", [("M6-1", 12)]),
    "cheese_head_screw": ("CheeseHeadScrew", "iso1207", [("M6-1", 16), ("M8-1.25", 16)]),
    "collar_screw": ("ButtonHeadWithCollarScrew", "iso7380_2", [("M8-1.25", 16), ("M10-1.5", 16)]),
    "shoulder_screw": ("ShoulderScrew", "iso7379", [("M8-1.25", 16), ("M10-1.5", 25)]),
}
NUTS = {"flange_nut": ("HexNutWithFlange", "din1665", ["M10-1.5", "M16-2"])}
BEARINGS = {
    "ball_bearing": ("SingleRowDeepGrooveBallBearing", ["M9-17-4", "M10-19-5"]),
    "roller_bearing": ("SingleRowCylindricalRollerBearing", ["M15-35-11", "M17-40-16"]),
}


def fill_cage(part: bearing.Bearing) -> Compound:
    """Joins the races of a bearing by a web where the cage is."""
    box = part.bounding_box()
    inner, outer = (part.race_center_radius + side * 0.45 * part.roller_diameter
                    for side in (-1, 1))
    web = Cylinder(outer, 0.8 * box.size.Z) - Cylinder(inner, box.size.Z)
    return Compound(children=[part, Pos(Z=box.center().Z) * web])


def fuse_bodies(part: Shape) -> Shape:
    """Fuses the shank and the turns of its thread, which are bodies of their own."""
    first, *others = part.solids()
    return first.fuse(*others)


def make_parts() -> Iterator[tuple[str, str, Shape]]:
    """Makes every part: family, variant and solid."""
    for family, (name, standard, sizes) in SCREWS.items():
        for size, length in sizes:  # threaded: otherwise most would be headed pins
            part = getattr(fastener, name)(size, length, standard, simple=False)
            yield family, f"{standard}_{size}x{length}", fuse_bodies(part)
    for family, (name, standard, sizes) in NUTS.items():
        for size in sizes:
            yield family, f"{standard}_{size}", getattr(fastener, name)(size, standard)
    for family, (name, sizes) in BEARINGS.items():
        for size in sizes:
            yield family, size, fill_cage(getattr(bearing, name)(size))
    yield "t_nut", "open_builds", TNut()


def main(folder: Path) -> None:
    """Writes every part below the folder."""
    for family, variant, part in make_parts():
        path = folder / "bd_warehouse" / family / f"{variant}.stl"
        path.parent.mkdir(parents=True, exist_ok=True)
        distance, angle = _COARSE if family in BEARINGS else _FINE
        export_stl(part, path, tolerance=distance, angular_tolerance=angle)


if __name__ == "__main__":
    main(Path(sys.argv[1]))
