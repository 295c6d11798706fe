# SPDX-License-Identifier: Apache-2.0
"""Meshes with few faces: threads, lettering and fine round edges cost time and no form."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import trimesh

from stack_counter.lean_open3d import o3d
from stack_counter.sim.shapes.manifolds import make_manifold, simplify_manifold
from stack_counter.sim.shapes.shape import ShapeError

# Multiples of the wanted number of faces, tried in turn until a mesh does not tear; chosen.
_FACTORS = (1, 2, 3)


def simplify_solid(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """The same solid with few faces, closed, in one body, and of the same volume.

    About `max_faces`, or as many as it needs not to tear; the mesh itself if it is as coarse
    already or no way was found.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    for coarse in _decimate(mesh, max_faces):
        if len(coarse.faces) < len(mesh.faces) and coarse.is_watertight \
                and coarse.is_winding_consistent and coarse.body_count == 1 and coarse.volume > 0:
            coarse.apply_transform(trimesh.transformations.scale_matrix(
                (mesh.volume / coarse.volume) ** (1 / 3), mesh.center_mass))
            return coarse
    return mesh


def _decimate(mesh: trimesh.Trimesh, max_faces: int) -> Iterator[trimesh.Trimesh]:
    """Coarser meshes, from the one that keeps the form best for its number of faces on.

    The last one is coarser only where the form is flat or round, but does not tear.
    """
    fine = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(mesh.vertices)),
        o3d.utility.Vector3iVector(np.array(mesh.faces, np.int32)))
    for factor in _FACTORS:
        if factor * max_faces < len(mesh.faces):
            decimated = fine.simplify_quadric_decimation(factor * max_faces)
            yield trimesh.Trimesh(np.asarray(decimated.vertices), np.asarray(decimated.triangles))
    try:
        coarse = simplify_manifold(make_manifold(mesh), max_faces).to_mesh64()
    except ShapeError:
        return
    yield trimesh.Trimesh(coarse.vert_properties[:, :3], coarse.tri_verts)
