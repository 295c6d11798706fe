# SPDX-License-Identifier: Apache-2.0
"""A part's CAD file, read without the simulator: what poses are found by."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np

from stack_counter.errors import MeshError, PartError
from stack_counter.parts.catalogue import Part
from stack_counter.parts.solid_mesh import UNITS, ExpectedSolid, Solid, load_solid
from stack_counter.types import Mesh


@dataclass(frozen=True)
class PartSolidSettings:
    """Which solids are parts; chosen.

    Attributes:
        sizes_m: largest sides of parts that a robot cell handles, metres.
        same_volume: relative difference up to which a mesh has the volume of a known part.
    """

    sizes_m: tuple[float, float] = (0.003, 0.5)
    same_volume: float = 1e-2


SETTINGS = PartSolidSettings()
_PART = ExpectedSolid("part", SETTINGS.sizes_m, "one part, not an assembly")


def load_part_solid(path: Path, unit: str) -> Solid:
    """Reads and checks a CAD file of a part, as `load_solid` does."""
    return load_solid(path, unit, _PART)


def load_solid_of_volume(path: Path, unit_volume: float) -> Solid:
    """Reads the CAD file of a part whose volume says in which unit its numbers are.

    Args:
        path: as of `load_solid`.
        unit_volume: v of the part, m3.

    Raises:
        FileNotFoundError: no such file.
        MeshError: it is no solid, or has another volume in every unit.
    """
    seen = []
    for unit in UNITS:
        try:
            solid = load_part_solid(path, unit)
        except MeshError as error:
            seen.append(f"in {unit} {error}")
            continue
        volume = float(solid.mesh.volume)
        if math.isclose(volume, unit_volume, rel_tol=SETTINGS.same_volume):
            return solid
        seen.append(f"in {unit} v is {volume * 1e6:.6g} cm3")
    raise MeshError(f"{path}: {'; '.join(seen)}; expected {unit_volume * 1e6:.6g} cm3, as the "
                    "catalogue says: part add it again")


def read_part_surface(part: Part) -> Mesh | None:
    """Reads the surface of a part, in the axes of its CAD file; None where it has none.

    A file that was read before and has not changed is remembered.

    Raises:
        PartError: the file is missing, no solid, or of another volume.
    """
    if part.mesh is None:
        return None
    try:
        return _cached_surface(part.mesh, part.mesh.stat().st_mtime_ns, part.unit_volume)
    except (OSError, MeshError) as error:
        raise PartError(f"the mesh of part '{part.name}', by which its pose is found, cannot be "
                        f"read: {error}") from error


@lru_cache(maxsize=4)
def _cached_surface(path: Path, modified_ns: int, unit_volume: float) -> Mesh:
    mesh = load_solid_of_volume(path, unit_volume).mesh
    return Mesh(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.int32))
