# SPDX-License-Identifier: Apache-2.0
"""A part's mesh from a CAD file, checked: what v is computed from and piles are made of."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter.parts.part_solid import load_part_solid, load_solid_of_volume
from stack_counter.parts.solid_mesh import Solid
from stack_counter.sim import simplify_solid


@dataclass(frozen=True)
class PartMeshSettings:
    """How meshes are simulated; chosen.

    Attributes:
        max_faces: number of triangles for simulation; more bring time and no form.
    """

    max_faces: int = 6000


SETTINGS = PartMeshSettings()


@dataclass(frozen=True, eq=False)
class PartMesh:
    """One solid.

    Attributes:
        vertices: (n, 3) float64, metres, centre of mass at the origin.
        faces: (m, 3) int32, counter-clockwise from outside; some thousands.
        unit_volume: v of the mesh as it came, m3.
        notes: lines on what was put right.
    """

    vertices: np.ndarray
    faces: np.ndarray
    unit_volume: float
    notes: tuple[str, ...] = ()

    @property
    def size_m(self) -> np.ndarray:
        """(3,) sides of its bounding box, metres."""
        return np.ptp(self.vertices, axis=0)


def load_part_mesh(path: Path, unit: str = "mm") -> PartMesh:
    """Reads and checks a CAD file.

    Args:
        path: STL, OBJ, PLY, OFF or STEP.
        unit: unit of the file's numbers, a key of `solid_mesh.UNITS`; STEP files name their own.

    Raises:
        FileNotFoundError: no such file.
        MeshError: not a mesh, not watertight, not one body, or of no plausible size.
    """
    return _simplified(load_part_solid(path, unit))


def load_mesh_of_volume(path: Path, unit_volume: float) -> PartMesh:
    """Reads the CAD file of a part whose volume says in which unit its numbers are.

    Args:
        path: as of `load_part_mesh`.
        unit_volume: v of the part, m3.

    Raises:
        FileNotFoundError: no such file.
        MeshError: it is no solid, or has another volume in every unit.
    """
    return _simplified(load_solid_of_volume(path, unit_volume))


def _simplified(solid: Solid) -> PartMesh:
    """The solid with the triangles that simulation takes."""
    mesh, notes = solid.mesh, list(solid.notes)
    # v is that of the mesh as it came; the simulated one has fewer triangles
    volume = float(mesh.volume)
    coarse = simplify_solid(mesh, SETTINGS.max_faces)
    if coarse is not mesh:
        notes.append(f"{len(mesh.faces)} triangles; simulated with {len(coarse.faces)}, without "
                     "fine threads and lettering; v is exact")
        mesh = coarse
    return PartMesh(np.asarray(mesh.vertices - mesh.center_mass, float),
                    np.asarray(mesh.faces, np.int32), volume, tuple(notes))
