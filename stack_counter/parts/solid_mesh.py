# SPDX-License-Identifier: Apache-2.0
"""One solid from a CAD file, checked: closed, a single body, of a plausible size."""

from __future__ import annotations

import importlib.util
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stack_counter.errors import MeshError
from stack_counter.parts.step_file import load_step

if TYPE_CHECKING:  # it loads SciPy, and the simulator's solids where they are installed
    import trimesh

UNITS = {"mm": 1e-3, "m": 1.0, "in": 0.0254}
_SUFFIXES = (".stl", ".obj", ".ply", ".off", ".step", ".stp")
_FARTHEST = 1e8  # in the file's unit; chosen: no part is as far from its origin
# Files that name their unit: their meshes are in metres once they are read.
_STEP_SUFFIXES = (".step", ".stp")


@dataclass(frozen=True)
class ExpectedSolid:
    """What a CAD file is expected to hold.

    Attributes:
        name: what it is, for errors.
        sizes_m: least and largest plausible length of its longest side, metres.
        single: what is meant by one body, for errors.
    """

    name: str
    sizes_m: tuple[float, float]
    single: str


@dataclass(frozen=True, eq=False)
class Solid:
    """One closed body.

    Attributes:
        mesh: metres, in the file's own axes, faces counter-clockwise from outside.
        notes: lines on what was put right.
    """

    mesh: trimesh.Trimesh
    notes: tuple[str, ...]


def load_solid(path: Path, unit: str, expected: ExpectedSolid) -> Solid:
    """Reads and checks a CAD file.

    Args:
        path: STL, OBJ, PLY, OFF or STEP.
        unit: unit of the file's numbers, a key of `UNITS`; STEP files name their own.
        expected: what it should hold.

    Raises:
        FileNotFoundError: no such file.
        MeshError: not a mesh, not watertight, not one body, or of no plausible size.
    """
    if not path.is_file():
        raise FileNotFoundError(f"no mesh {path}; expected one of {', '.join(_SUFFIXES)}")
    # One closed body, its faces seen from outside
    mesh = _read_mesh(path, expected)
    _check_closed(mesh, path.name)
    notes: list[str] = []
    mesh = _single_body(mesh, path.name, expected, notes)
    if mesh.volume < 0:
        mesh.invert()
        notes.append("the mesh was inside out and has been turned")
    # In metres
    scale = 1.0 if path.suffix.lower() in _STEP_SUFFIXES else UNITS[unit]
    _check_size(float(mesh.extents.max()), scale, unit, path.name, expected.sizes_m)
    mesh.apply_scale(scale)
    return Solid(mesh, tuple(notes))


def _read_mesh(path: Path, expected: ExpectedSolid) -> trimesh.Trimesh:
    """The mesh of a file in its own unit, seams and slivers mended as far as that is safe."""
    import trimesh

    suffix = path.suffix.lower()
    if suffix not in _SUFFIXES:
        raise MeshError(f"{path.name} ends in '{path.suffix}'; expected one of "
                        f"{', '.join(_SUFFIXES)}")
    if suffix in _STEP_SUFFIXES and importlib.util.find_spec("cascadio") is None:
        raise MeshError(f"{path.name} is STEP and no reader for it is installed; expected the "
                        "extra `cad`: pip install 'stack_counter[cad]'")
    try:
        mesh = load_step(path) if suffix in _STEP_SUFFIXES \
            else trimesh.load_mesh(path, process=False)
        if isinstance(mesh, trimesh.Scene):
            mesh = mesh.to_mesh()
    except MeshError:
        raise
    except Exception as error:  # the readers' own, of many kinds
        said = " ".join(str(error).split()) or type(error).__name__
        raise MeshError(f"{path.name} cannot be read: {said}; expected a mesh") from error
    if not isinstance(mesh, trimesh.Trimesh) or not len(mesh.faces):
        raise MeshError(f"{path.name} holds no triangle; expected a solid {expected.name}")
    _check_numbers(mesh, path.name)
    # Merge vertices and drop triangles that are lines; slivers stay: they may close a seam
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    corners = np.sort(mesh.faces, axis=1)
    mesh.update_faces((corners[:, 1:] != corners[:, :-1]).all(axis=1))
    mesh.remove_unreferenced_vertices()
    return mesh


def _check_numbers(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuses corners that are no points of space, and triangles of corners that are not there."""
    if mesh.vertices.shape[1:] != (3,) or mesh.faces.shape[1:] != (3,):
        raise MeshError(f"{name} has corners of {mesh.vertices.shape[-1]} numbers and faces of "
                        f"{mesh.faces.shape[-1]} corners; expected 3 each")
    if not (np.abs(mesh.vertices) < _FARTHEST).all():
        raise MeshError(f"{name} has coordinates that are not finite, or {_FARTHEST:g} and more; "
                        "expected numbers around a part")
    if not (0 <= mesh.faces.min() and mesh.faces.max() < len(mesh.vertices)):
        raise MeshError(f"{name} has triangles of corners {mesh.faces.min()} to "
                        f"{mesh.faces.max()}; expected 0 to {len(mesh.vertices) - 1}")


def _check_closed(mesh: trimesh.Trimesh, name: str) -> None:
    """Refuses an open mesh; mends the winding of a closed one in place."""
    import trimesh

    if not mesh.is_watertight:
        uses = np.unique(mesh.edges_unique_inverse, return_counts=True)[1]
        raise MeshError(f"{name} is not watertight: {int((uses != 2).sum())} of {len(uses)} edges "
                        "do not join two triangles; expected 0")
    if not mesh.is_winding_consistent:
        trimesh.repair.fix_winding(mesh)


def _single_body(mesh: trimesh.Trimesh, name: str, expected: ExpectedSolid, notes: list[str]
                 ) -> trimesh.Trimesh:
    """The only body; voids inside it, which nothing can enter, belong to it."""
    bodies = sorted(mesh.split(only_watertight=False), key=lambda b: -float(np.prod(b.extents)))
    outer = bodies[0]
    # A void lies within the outer body, and its volume has the other sign
    outside = [b for b in bodies[1:] if (b.bounds[0] < outer.bounds[0]).any()
               or (b.bounds[1] > outer.bounds[1]).any() or b.volume * outer.volume > 0]
    if outside:
        raise MeshError(f"{name} holds {len(outside) + 1} bodies; expected 1: {expected.single}")
    if len(bodies) > 1:
        notes.append(f"{len(bodies) - 1} closed voids inside are counted as part of it")
    return outer


def _check_size(size: float, scale: float, unit: str, name: str,
                sizes_m: tuple[float, float]) -> None:
    """Refuses an implausible size, and names the units in which it would be plausible."""
    low, high = sizes_m
    if low <= size * scale <= high:
        return
    likely = [f"{other} ({size * factor * 1000:.4g} mm)" for other, factor in UNITS.items()
              if low <= size * factor <= high]
    raise MeshError(
        f"{name} is {size * scale * 1000:.4g} mm large in {unit}; expected {low * 1000:.0f} to "
        f"{high * 1000:.0f} mm" + (f"; its unit may be {' or '.join(likely)}: --unit" if likely
                                   else ""))
