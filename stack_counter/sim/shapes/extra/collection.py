# SPDX-License-Identifier: Apache-2.0
"""Collections of solids that others have made, in the form that `simulate --library` takes.

One npz holds the meshes: `verts` int16 (v, 3), `faces` uint16 (f, 3), those of each solid from
0, `voff` and `foff` int64 (n + 1,) where each begins, `scale` of `verts`, `ids` (n,) str and
`size_mm` (n,) float32, the real longest side, NaN if it is unknown. Every solid is one closed
body, centred on its bounding box, whose longest side is 1. The index beside it, of the same name
with `.json`, lists `shapes` in that order: `id`, `source`, `licence`, `family`, `author` and
`size_mm`.

    python scripts/convert_shapes.py FOLDER TABLE.csv OUT.npz

makes one of a folder of meshes.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import trimesh
from manifold3d import Error, Manifold, Mesh, OpType

from stack_counter.sim.shapes.extra.skin import make_skin
from stack_counter.sim.shapes.manifolds import simplify_manifold
from stack_counter.sim.shapes.shape import ShapeError, shape_from_mesh

_SCALE = 1 / 65534  # of the format: 16 bits for a side of 1


@dataclass(frozen=True)
class CollectionSettings:
    """How meshes become solids; chosen.

    Attributes:
        max_faces: triangles that a solid is simplified to if that is possible.
        alike: largest difference of the logs of side lengths, volume and area of two solids that
            are taken for the same one.
    """

    max_faces: int = 1500
    alike: float = 0.01


SETTINGS = CollectionSettings()


@dataclass(frozen=True, eq=False)
class Origin:
    """Where a solid comes from.

    Attributes:
        id: name of its own.
        source: name of the collection, such as LDraw; folds leave out whole sources.
        licence: under which it may be used.
        family: kind of thing within the source.
        author: whom to credit beside the source.
    """

    id: str
    source: str
    licence: str
    family: str
    author: str = ""


@dataclass(frozen=True, eq=False)
class CollectedSolid:
    """One solid of a collection.

    Attributes:
        origin: where it comes from.
        vertices: (n, 3) int16 in units of 1 / 65,534 of the longest side.
        faces: (m, 3) uint16, counter-clockwise from outside.
        size_mm: longest side, mm; NaN: unknown.
    """

    origin: Origin
    vertices: np.ndarray
    faces: np.ndarray
    size_mm: float

    @property
    def features(self) -> np.ndarray:
        """(4,) logs of the two shorter sides, volume and area, by which doubles are found."""
        mesh = trimesh.Trimesh(self.vertices * _SCALE, self.faces, process=False)
        sides = np.sort(mesh.extents)[:2]
        return np.log([*np.maximum(sides, 1e-6), mesh.volume, mesh.area])


def solidify(mesh: trimesh.Trimesh, origin: Origin, mm_per_unit: float) -> CollectedSolid:
    """Fuses a mesh's bodies to one solid, simplifies it, centres it and scales it to 1.

    A mesh that is not closed is replaced by its outer skin.

    Args:
        mesh: in any unit.
        origin: where it comes from.
        mm_per_unit: millimetres of the mesh's unit; NaN if its real size is unknown.

    Raises:
        ShapeError: it is not one body.
    """
    size = float(mesh.extents.max())
    try:
        whole = simplify_manifold(fuse_bodies(mesh), SETTINGS.max_faces)
    except ShapeError:
        whole = make_skin(mesh, SETTINGS.max_faces)
    coarse = whole.to_mesh64()
    vertices = np.asarray(coarse.vert_properties)[:, :3]
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    rounded = np.round((vertices - (low + high) / 2) / (high - low).max() / _SCALE)
    # As a reader will make it: corners that are one once they are rounded are merged.
    shape = shape_from_mesh(rounded * _SCALE, coarse.tri_verts, origin.id, part_size=0.03)
    if len(shape.vertices) > np.iinfo(np.uint16).max:
        raise ShapeError(f"{origin.id}: {len(shape.vertices)} vertices that cannot be fewer; "
                         f"expected at most {np.iinfo(np.uint16).max}")
    return CollectedSolid(origin, rounded.astype(np.int16),
                          np.asarray(coarse.tri_verts, np.uint16), size * mm_per_unit)


def fuse_bodies(mesh: trimesh.Trimesh) -> Manifold:
    """Fuses the bodies of a mesh to one solid.

    Raises:
        ShapeError: a body is not closed, or there is none.
    """
    mesh.merge_vertices(merge_tex=True, merge_norm=True)
    mesh.update_faces(mesh.nondegenerate_faces())
    bodies = []
    for body in mesh.split(only_watertight=False):
        if body.is_watertight and body.volume < 0:
            body.invert()
        bodies.append(Manifold(Mesh(body.vertices.astype(np.float32),
                                    body.faces.astype(np.uint32))))
        if bodies[-1].status() != Error.NoError:
            raise ShapeError(f"a body of {len(body.faces)} faces is {bodies[-1].status()}; "
                             "expected a closed one")
    whole = Manifold.batch_boolean(bodies, OpType.Add)
    if whole.is_empty():
        raise ShapeError("encloses no volume; expected a solid")
    return whole


def drop_doubles(solids: list[CollectedSolid]) -> list[CollectedSolid]:
    """The first of each kind of solids that differ by less than `SETTINGS.alike`."""
    kept: list[CollectedSolid] = []
    features = np.empty((0, 4))
    for solid in solids:
        own = solid.features
        if not (np.abs(features - own).max(axis=1) < SETTINGS.alike).any():
            kept.append(solid)
            features = np.vstack([features, own])
    return kept


def write_collection(path: Path, solids: list[CollectedSolid]) -> None:
    """Writes the npz and the index beside it."""
    np.savez_compressed(
        path, verts=np.concatenate([s.vertices for s in solids]),
        faces=np.concatenate([s.faces for s in solids]),
        voff=np.cumsum([0] + [len(s.vertices) for s in solids], dtype=np.int64),
        foff=np.cumsum([0] + [len(s.faces) for s in solids], dtype=np.int64),
        scale=np.float64(_SCALE), ids=np.array([s.origin.id for s in solids]),
        size_mm=np.array([s.size_mm for s in solids], np.float32))
    shapes = [{**vars(s.origin), "size_mm": s.size_mm if np.isfinite(s.size_mm) else None}
              for s in solids]
    path.with_suffix(".json").write_text(json.dumps({"count": len(shapes), "shapes": shapes},
                                                    indent=1) + "\n", encoding="utf-8")
