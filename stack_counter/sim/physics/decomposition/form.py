# SPDX-License-Identifier: Apache-2.0
"""How well convex pieces keep a part's form: how much fuller they are, and how far they stand out.

A pile's gamma follows the form only from afar: pieces half as full again change it by 3%.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold, OpType

from stack_counter.lean_open3d import o3d

# Points on the pieces' surface from which protrusion is measured, and their seed; chosen.
_POINTS, _SEED = 4000, 0


@dataclass(frozen=True)
class PieceForm:
    """What convex pieces together look like beside the part.

    Attributes:
        fullness: volume of the pieces' union over that of the part.
        protrusion: by how much 95% of the union's surface stand out of the part at most, in part
            sizes.
        farthest: by how much all of it does.
    """

    fullness: float
    protrusion: float
    farthest: float


def measure_form(mesh: trimesh.Trimesh, pieces: list[np.ndarray]) -> PieceForm:
    """Measures the union of convex pieces, corners (n, 3) in the frame and unit of the mesh."""
    union = Manifold.batch_boolean([Manifold.hull_points(corners) for corners in pieces],
                                   OpType.Add)
    surface = union.to_mesh64()
    points, _ = trimesh.sample.sample_surface(
        trimesh.Trimesh(surface.vert_properties[:, :3], surface.tri_verts, process=False),
        _POINTS, seed=_SEED)
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    outside = np.maximum(scene.compute_signed_distance(
        np.asarray(points, np.float32), nsamples=3).numpy(), 0) / mesh.extents.max()
    return PieceForm(float(union.volume() / mesh.volume), float(np.quantile(outside, 0.95)),
                     float(outside.max()))
