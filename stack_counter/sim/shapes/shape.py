# SPDX-License-Identifier: Apache-2.0
"""One part as a checked mesh, and the measures of its form."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import trimesh

from stack_counter.errors import StackCounterError

# kappa_0 of the paper's section 4.5: the maximum of kappa / diagonal over `make_shape(seed)` for
# seeds 0 to 1999, the training families.
REFERENCE_CURVATURE = 36.6


@dataclass(frozen=True)
class ShapeSettings:
    """Which meshes are parts; chosen.

    Attributes:
        max_faces: largest number of faces.
        sizes_m: part sizes that a robot cell handles, metres.
        min_fill: least V / part_size**3; less is a sheet without thickness.
    """

    max_faces: int = 20_000
    sizes_m: tuple[float, float] = (0.001, 0.5)
    min_fill: float = 1e-4


SETTINGS = ShapeSettings()


class ShapeError(StackCounterError):
    """A mesh is not one watertight body of a plausible size, or its family is unknown."""


@dataclass(frozen=True)
class Shape:
    """One part.

    Attributes:
        family: name of the generator, or of the mesh's origin.
        vertices: (n, 3) float64, metres, centre of mass at the origin.
        faces: (m, 3) int32, counter-clockwise from outside.
        seed: seed of the generator; -1 if the mesh was given.
    """

    family: str
    vertices: np.ndarray
    faces: np.ndarray
    seed: int = -1

    @cached_property
    def mesh(self) -> trimesh.Trimesh:
        """The part as a mesh, metres."""
        return trimesh.Trimesh(self.vertices, self.faces, process=False)

    @cached_property
    def unit_volume(self) -> float:
        """v of the mesh as stored, m3."""
        return float(self.mesh.volume)

    @cached_property
    def part_size(self) -> float:
        """Largest side of the bounding box, metres."""
        return float(np.ptp(self.vertices, axis=0).max())

    @cached_property
    def convexity(self) -> float:
        """V / V_hull, in (0, 1]."""
        return min(1.0, self.unit_volume / float(self.mesh.convex_hull.volume))

    @cached_property
    def scaled_curvature(self) -> float:
        """Integrated mean curvature kappa over the bounding box's diagonal.

        Half the sum of edge length times dihedral angle. The angles are absolute: with signs,
        dents would cancel bumps, and a rugged part would pass for a smooth one.
        """
        mesh = self.mesh
        ends = mesh.vertices[mesh.face_adjacency_edges]  # (e, 2, 3)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        diagonal = np.linalg.norm(np.ptp(self.vertices, axis=0))
        return float(lengths @ mesh.face_adjacency_angles / 2 / diagonal)

    @cached_property
    def complexity(self) -> float:
        """Surface complexity C. Source: 3DC, section 4.5."""
        return self.scaled_curvature / REFERENCE_CURVATURE + 1 - self.convexity


def shape_from_mesh(vertices: np.ndarray, faces: np.ndarray, family: str, seed: int = -1,
                    part_size: float | None = None) -> Shape:
    """Checks a mesh and moves its centre of mass to the origin.

    Duplicate vertices are merged; any other fault is refused, not mended.

    Args:
        vertices: (n, 3), metres, or any unit if part_size is given.
        faces: (m, 3) indices, counter-clockwise from outside.
        family: name of the generator, or of the mesh's origin.
        seed: seed of the generator; -1 if the mesh was given.
        part_size: largest side of the bounding box to scale to, metres.

    Raises:
        ShapeError: the mesh is not one watertight body of a plausible size.
    """
    vertices, faces = np.asarray(vertices, np.float64), np.asarray(faces)
    _check_arrays(vertices, faces, family)
    if part_size is not None:
        vertices = vertices * (part_size / np.ptp(vertices, axis=0).max())
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    mesh.merge_vertices()
    _check_solid(mesh, family)
    return Shape(family, np.array(mesh.vertices - mesh.center_mass),
                 np.array(mesh.faces, np.int32), seed)


def _check_arrays(vertices: np.ndarray, faces: np.ndarray, family: str) -> None:
    """Refuses arrays of other shapes than (n, 3), too many faces, and bad values."""
    for name, array in (("vertices", vertices), ("faces", faces)):
        if array.ndim != 2 or array.shape[1] != 3 or not len(array):
            raise ShapeError(f"{family}: {name} have shape {array.shape}; expected (n, 3), n > 0")
    if len(faces) > SETTINGS.max_faces:
        raise ShapeError(f"{family}: {len(faces)} faces; expected at most {SETTINGS.max_faces}: "
                         "leave out threads, lettering, gratings and lattices, or export it "
                         "coarser")
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise ShapeError(f"{family}: face indices {faces.min()} to {faces.max()}; "
                         f"expected 0 to {len(vertices) - 1}")
    invalid = int((~np.isfinite(vertices).all(axis=1)).sum())
    if invalid:
        raise ShapeError(f"{family}: {invalid} of {len(vertices)} vertices are NaN or infinite; "
                         "expected finite coordinates")


def _check_solid(mesh: trimesh.Trimesh, family: str) -> None:
    """Refuses what is not one closed body of a plausible size, its faces seen from outside."""
    size = float(mesh.extents.max())
    low, high = SETTINGS.sizes_m
    if not low <= size <= high:
        raise ShapeError(f"{family}: part size {size:.4g} m; expected {low} to {high} m")
    if not mesh.is_watertight:
        uses = np.unique(mesh.edges_unique_inverse, return_counts=True)[1]
        raise ShapeError(f"{family}: {int((uses != 2).sum())} edges do not join two faces; "
                         "expected a watertight mesh with none")
    if mesh.body_count != 1:
        raise ShapeError(f"{family}: {mesh.body_count} bodies; expected 1")
    least_volume = SETTINGS.min_fill * size**3
    if not mesh.is_winding_consistent or mesh.volume < least_volume:
        raise ShapeError(
            f"{family}: volume {mesh.volume:.4g} m3, winding consistent "
            f"{mesh.is_winding_consistent}; expected at least {least_volume:.4g} m3 with every "
            "face counter-clockwise from outside")
