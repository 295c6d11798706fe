# SPDX-License-Identifier: Apache-2.0
"""A part's mesh from a CAD file, checked: what v is computed from and piles are made of."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import open3d as o3d
import trimesh

from stack_counter.errors import PartError

UNITS = {"mm": 1e-3, "m": 1.0, "in": 0.0254}
_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".step", ".stp")
# Files that name their unit: their meshes are in metres once they are read.
_STEP_SUFFIXES = (".step", ".stp")


@dataclass(frozen=True)
class PartMeshSettings:
    """Which meshes are parts; chosen.

    Attributes:
        sizes_m: largest sides of parts that a robot cell handles, metres.
        max_faces: largest number of triangles for simulation; more bring time and no form.
        face_factors: multiples of that, tried in turn until a mesh can be made so coarse without
            tearing.
    """

    sizes_m: tuple[float, float] = (0.003, 0.5)
    max_faces: int = 6000
    face_factors: tuple[int, ...] = (1, 2, 3)


SETTINGS = PartMeshSettings()


@dataclass(frozen=True, eq=False)
class PartMesh:
    """One solid.

    Attributes:
        vertices: (n, 3) float64, metres, centre of mass at the origin.
        faces: (m, 3) int32, counter-clockwise from outside, at most 18,000.
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
        unit: unit of the file's numbers, a key of `UNITS`; STEP files name their own.

    Raises:
        FileNotFoundError: no such file.
        PartError: not a mesh, not watertight, not one body, or of no plausible size.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no mesh {path}; expected one of {', '.join(_SUFFIXES)}")
    # One closed body, its faces seen from outside
    mesh = _read_mesh(path)
    _check_closed(mesh, path.name)
    notes: list[str] = []
    mesh = _single_body(mesh, path.name, notes)
    if mesh.volume < 0:
        mesh.invert()
        notes.append("the mesh was inside out and has been turned")
    # In metres
    scale = 1.0 if path.suffix.lower() in _STEP_SUFFIXES else UNITS[unit]
    _check_size(float(mesh.extents.max()), scale, unit, path.name)
    mesh.apply_scale(scale)
    # v is that of the mesh as it came; the simulated one has fewer triangles
    volume = float(mesh.volume)
    if len(mesh.faces) > SETTINGS.max_faces:
        notes.append(f"{len(mesh.faces)} triangles; simulated with {SETTINGS.max_faces}, v is "
                     "exact")
        mesh = _simplify(mesh, path.name)
    return PartMesh(np.asarray(mesh.vertices - mesh.center_mass, float),
                    np.asarray(mesh.faces, np.int32), volume, tuple(notes))


def _read_mesh(path: Path) -> trimesh.Trimesh:
    """The mesh of a file in its own unit, seams and slivers mended as far as that is safe."""
    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise PartError(f"{path.name} ends in '{path.suffix}'; expected one of "
                        f"{', '.join(_SUFFIXES)}")
    if suffix in _STEP_SUFFIXES and importlib.util.find_spec("cascadio") is None:
        raise PartError(f"{path.name} is STEP and no reader for it is installed; expected the "
                        "extra `cad`: pip install 'stack_counter[cad]'")
    try:
        mesh = trimesh.load_mesh(path, process=False)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
    except Exception as error:  # the readers' own, of many kinds
        raise PartError(f"{path.name} cannot be read: {error or type(error).__name__}; expected "
                        "a mesh") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise PartError(f"{path.name} holds no triangle; expected a solid part")
    if not np.isfinite(mesh.vertices).all():
        raise PartError(f"{path.name} has coordinates that are not finite; expected numbers")
    # Merge vertices and drop triangles that are lines; slivers stay: they may close a seam
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    corners = np.sort(mesh.faces, axis=1)
    mesh.update_faces((corners[:, 1:] != corners[:, :-1]).all(axis=1))
    mesh.remove_unreferenced_vertices()
    return mesh


def _check_closed(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuses an open mesh; mends the winding of a closed one in place."""
    if not mesh.is_watertight:
        uses = np.unique(mesh.edges_unique_inverse, return_counts=True)[1]
        raise PartError(f"{name} is not watertight: {int((uses != 2).sum())} of {len(uses)} edges "
                        "do not join two triangles; expected 0")
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)


def _single_body(mesh: trimesh.Trimesh, name: str, notes: list[str]) -> trimesh.Trimesh:
    """The only body; voids inside it, which no other part can enter, belong to it."""
    bodies = sorted(mesh.split(only_watertight=False), key=lambda b: -float(np.prod(b.extents)))
    outer = bodies[0]
    # A void lies within the outer body, and its volume has the other sign
    outside = [b for b in bodies[1:] if (b.bounds[0] < outer.bounds[0]).any()
               or (b.bounds[1] > outer.bounds[1]).any() or b.volume * outer.volume > 0]
    if outside:
        raise PartError(f"{name} holds {len(outside) + 1} bodies; expected 1: one part, not an "
                        "assembly")
    if len(bodies) > 1:
        notes.append(f"{len(bodies) - 1} closed voids inside are counted as part of it")
    return outer


def _check_size(size: float, scale: float, unit: str, name: str) -> None:
    """Refuses an implausible size, and names the units in which it would be plausible."""
    low, high = SETTINGS.sizes_m
    if low <= size * scale <= high:
        return
    likely = [f"{other} ({size * factor * 1000:.4g} mm)" for other, factor in UNITS.items()
              if low <= size * factor <= high]
    raise PartError(
        f"{name} is {size * scale * 1000:.4g} mm large in {unit}; expected {low * 1000:.0f} to "
        f"{high * 1000:.0f} mm" + (f"; its unit may be {' or '.join(likely)}: --unit" if likely
                                   else ""))


def _simplify(mesh: trimesh.Trimesh, name: str) -> trimesh.Trimesh:
    """The mesh with few triangles, watertight, and of the same volume."""
    fine = o3d.geometry.TriangleMesh(o3d.utility.Vector3dVector(mesh.vertices),
                                     o3d.utility.Vector3iVector(mesh.faces))
    for factor in SETTINGS.face_factors:
        decimated = fine.simplify_quadric_decimation(factor * SETTINGS.max_faces)
        coarse = trimesh.Trimesh(np.asarray(decimated.vertices), np.asarray(decimated.triangles))
        if coarse.is_watertight and coarse.is_winding_consistent and coarse.body_count == 1 \
                and coarse.volume > 0:
            coarse.apply_scale((mesh.volume / coarse.volume) ** (1 / 3))
            return coarse
    most = SETTINGS.face_factors[-1] * SETTINGS.max_faces
    raise PartError(f"{name} has {len(mesh.faces)} triangles that cannot be made {most} or fewer "
                    "without tearing; expected a coarser mesh")
