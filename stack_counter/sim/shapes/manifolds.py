# SPDX-License-Identifier: Apache-2.0
"""Meshes as solids of manifold3d: none of its operations tears them."""

from __future__ import annotations

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh64

from stack_counter.sim.shapes.shape import ShapeError

# By which shares of the part size simplification may move a surface, tried in turn; chosen.
TOLERANCES = (0.001, 0.002, 0.004, 0.008, 0.016)


def make_manifold(mesh: trimesh.Trimesh) -> Manifold:
    """The solid that a closed mesh bounds.

    Raises:
        ShapeError: its faces make no solid.
    """
    solid = Manifold(Mesh64(np.array(mesh.vertices, np.float64, order="C"),
                            np.array(mesh.faces, np.uint64, order="C")))
    if solid.status() != Error.NoError:
        raise ShapeError(f"no solid: faces of the mesh make none ({solid.status().name}); "
                         "expected each edge between two faces, no face twice: export the part "
                         "again as one solid")
    return solid


def simplify_manifold(whole: Manifold, max_faces: int) -> Manifold:
    """Simplifies a solid to so many triangles, if that is possible."""
    low, high = np.split(np.array(whole.bounding_box()), 2)
    coarse = whole
    for share in TOLERANCES:
        coarse = whole.simplify(share * float((high - low).max()))
        if coarse.num_tri() <= max_faces:
            break
    return coarse
