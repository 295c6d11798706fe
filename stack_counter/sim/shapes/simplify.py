# SPDX-License-Identifier: Apache-2.0
"""Meshes with few faces: threads, lettering and fine round edges cost time and no form."""

from __future__ import annotations

import numpy as np
import open3d as o3d
import trimesh

# Multiples of the wanted number of faces, tried in turn until a mesh does not tear; chosen.
_FACTORS = (1, 2, 3, 6)


def simplify_solid(mesh: trimesh.Trimesh, max_faces: int) -> trimesh.Trimesh:
    """The same solid with few faces, closed, in one body, and of the same volume.

    About `max_faces`, or a few times as many where it would tear; the mesh itself if it is as
    coarse already, or tears at any of them.
    """
    if len(mesh.faces) <= max_faces:
        return mesh
    fine = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(mesh.vertices)),
        o3d.utility.Vector3iVector(np.array(mesh.faces, np.int32)))
    for factor in _FACTORS:
        if factor * max_faces >= len(mesh.faces):
            break
        decimated = fine.simplify_quadric_decimation(factor * max_faces)
        coarse = trimesh.Trimesh(np.asarray(decimated.vertices), np.asarray(decimated.triangles))
        if coarse.is_watertight and coarse.is_winding_consistent and coarse.body_count == 1 \
                and coarse.volume > 0:
            coarse.apply_transform(trimesh.transformations.scale_matrix(
                (mesh.volume / coarse.volume) ** (1 / 3), mesh.center_mass))
            return coarse
    return mesh
