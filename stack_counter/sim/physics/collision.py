# SPDX-License-Identifier: Apache-2.0
"""Convex pieces for the physics: a hull for convex parts, a decomposition for the others.

Hulls alone make concave parts stand too loose: they cannot nest. By how much,
`python -m stack_counter.sim.reality` prints. No part is refused for its form: flat cuts where
their search ends in its budget, Voronoi cells elsewhere, both merged to few pieces, judged by how
well these keep the form.

The same mesh gives the same pieces at any load, and on any machine whose libraries round alike.
What is left to the machine: a search that hangs is ended by processor time (`flat_cuts`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from importlib.metadata import version

import numpy as np
import trimesh

from stack_counter.sim.physics.decomposition import flat_cuts, voronoi
from stack_counter.sim.physics.decomposition.cache import cache_key, load_pieces, store_pieces
from stack_counter.sim.physics.decomposition.form import PieceForm, measure_form
from stack_counter.sim.physics.decomposition.merging import merge_pieces
from stack_counter.sim.shapes import Shape
from stack_counter.sim.shapes.simplify import simplify_solid


@dataclass(frozen=True)
class CollisionSettings:
    """How finely concave parts are decomposed; chosen, if nothing else is said.

    Attributes:
        convex_from: V / V_hull from which a part is taken as convex.
        max_faces: faces to which a mesh is simplified before it is cut.
        thresholds: concavity that a piece may keep (CoACD), tried in this order.
        too_full: fullness of the pieces above which finer cuts are tried.
        few_pieces: number of pieces up to which finer cuts are tried.
        max_pieces: largest numbers of pieces of a part: the next where the form asks for it.
        max_fullness, max_protrusion: form that is taken: pieces 1.6 times as full as the part
            change gamma by 3%, in tees by 6%.
        hull_corners: most corners of a hull, the engine's limit.
        piece_corners: most corners of one piece of many: more bring time and little form.
    """

    convex_from: float = 0.97
    max_faces: int = 4000
    thresholds: tuple[float, ...] = (0.08, 0.04, 0.02)
    too_full: float = 1.2
    few_pieces: int = 12
    max_pieces: tuple[int, ...] = (24, 48)
    max_fullness: float = 1.6
    max_protrusion: float = 0.04
    hull_corners: int = 64
    piece_corners: int = 32


SETTINGS = CollisionSettings()
# All that the pieces of a mesh depend on
_MADE_BY = (SETTINGS, flat_cuts.SETTINGS, voronoi.SETTINGS,
            *(f"{library} {version(library)}" for library in
              ("coacd", "manifold3d", "numpy", "open3d", "scipy", "trimesh")))


def convex_pieces(shape: Shape, decompose: bool = True) -> list[np.ndarray]:
    """Corners (n, 3) float64, metres, of the convex pieces; at most 64 each.

    Args:
        shape: the part.
        decompose: False takes the hull of any part, as the paper does.

    Raises:
        ShapeError: `no solid`: the faces of its mesh make none.
        CutterError: the process that cuts it was killed.
    """
    if not decompose or _is_convex(shape):
        return [_hull_corners(shape.mesh.convex_hull, SETTINGS.hull_corners)]
    return _known_pieces(shape.vertices.tobytes(), shape.faces.tobytes())


def rough_form(shape: Shape) -> PieceForm | None:
    """Form of a part's pieces where even the most that may be miss it; None where they keep it."""
    if _is_convex(shape):
        return None
    form = measure_form(shape.mesh, convex_pieces(shape))
    return None if _keeps_form(form) else form


def _is_convex(shape: Shape) -> bool:
    return shape.convexity > SETTINGS.convex_from


@lru_cache(maxsize=4)  # scenes of the same part come one after the other
def _known_pieces(vertices: bytes, faces: bytes) -> list[np.ndarray]:
    """Corners of the pieces of a mesh as they were stored, or made and stored now."""
    mesh = trimesh.Trimesh(np.frombuffer(vertices).reshape(-1, 3),
                           np.frombuffer(faces, np.int32).reshape(-1, 3), process=False)
    key = cache_key(mesh.vertices, mesh.faces, _MADE_BY)
    pieces = load_pieces(key)
    if pieces is None:
        pieces = _decompose(mesh)
        store_pieces(key, pieces)
    return pieces


def _decompose(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Corners of as few pieces as keep the form, or of the most that may be."""
    coarse = simplify_solid(mesh, SETTINGS.max_faces)
    cuts = _finest_cuts(coarse) or voronoi.cut_voronoi(coarse)
    for most in SETTINGS.max_pieces:
        pieces = _few_pieces(cuts, most)
        if len(cuts) <= most or _keeps_form(measure_form(mesh, pieces)):
            break
    return pieces


def _finest_cuts(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Corners of the finest flat cuts that are worth their number of pieces; none if none end."""
    finest: list[np.ndarray] = []
    kept = False
    for threshold in SETTINGS.thresholds:
        cuts = flat_cuts.cut_flat(np.asarray(mesh.vertices), np.asarray(mesh.faces, np.int32),
                                  threshold)
        if not cuts or kept and len(cuts) > SETTINGS.max_pieces[0]:
            break
        finest = cuts
        form = measure_form(mesh, _few_pieces(cuts, SETTINGS.max_pieces[0]))
        kept = _keeps_form(form)
        if kept and (len(cuts) > SETTINGS.few_pieces or form.fullness < SETTINGS.too_full):
            break
    return finest


def _keeps_form(form: PieceForm) -> bool:
    return form.fullness <= SETTINGS.max_fullness and form.protrusion <= SETTINGS.max_protrusion


def _few_pieces(cuts: list[np.ndarray], most: int) -> list[np.ndarray]:
    """Corners of at most so many pieces, each with few corners."""
    return [_hull_corners(trimesh.convex.convex_hull(corners), SETTINGS.piece_corners)
            for corners in merge_pieces(cuts, most)]


def _hull_corners(hull: trimesh.Trimesh, limit: int) -> np.ndarray:
    """(n, 3) corners of a hull.

    If they are more than the limit, those farthest apart, blown up to the hull's volume.
    """
    corners = np.asarray(hull.vertices)
    if len(corners) <= limit:
        return corners
    # Farthest point sampling, from the corner farthest from the middle
    chosen = [int(np.argmax(np.linalg.norm(corners - hull.center_mass, axis=1)))]
    distance = np.full(len(corners), np.inf)
    while len(chosen) < limit:
        distance = np.minimum(distance, np.linalg.norm(corners - corners[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    # Scale to the volume of the whole hull
    coarse = trimesh.convex.convex_hull(corners[chosen])
    factor = (hull.volume / coarse.volume) ** (1 / 3)
    return hull.center_mass + (corners[chosen] - hull.center_mass) * factor
