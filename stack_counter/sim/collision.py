"""Convex pieces for the physics: a hull for convex parts, a decomposition for the others.

Hulls alone make concave parts stand too loose: they cannot nest.
"""

from __future__ import annotations

import coacd
import numpy as np
import trimesh

from stack_counter.sim.shapes import Shape

_CONVEX = 0.97  # V / V_hull from which a part is taken as convex
_THRESHOLDS = (0.2, 0.1, 0.05)  # concavity that a piece may keep (coacd), tried in this order
_TOO_FULL = 1.25  # volume of the pieces over that of the part, above which a finer one is tried
_CORNERS = 64  # of a piece: the engine's limit

coacd.set_log_level("error")


def convex_pieces(shape: Shape) -> list[np.ndarray]:
    """Corners (n, 3) float64, metres, of the convex pieces; at most 64 each."""
    if shape.convexity > _CONVEX:
        return [_limited(shape.mesh)]
    mesh = coacd.Mesh(shape.vertices, shape.faces)
    for threshold in _THRESHOLDS:
        parts = [trimesh.Trimesh(*part) for part in coacd.run_coacd(mesh, threshold=threshold)]
        if sum(p.convex_hull.volume for p in parts) < _TOO_FULL * shape.unit_volume:
            break
    return [_limited(part) for part in parts]


def _limited(mesh: trimesh.Trimesh) -> np.ndarray:
    """Corners of the hull; of more than the limit the farthest apart, blown up to its volume."""
    hull = mesh.convex_hull
    corners = np.asarray(hull.vertices)
    if len(corners) <= _CORNERS:
        return corners
    chosen = [int(np.argmax(np.linalg.norm(corners - hull.center_mass, axis=1)))]
    distance = np.full(len(corners), np.inf)
    while len(chosen) < _CORNERS:
        distance = np.minimum(distance, np.linalg.norm(corners - corners[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    fewer = trimesh.convex.convex_hull(corners[chosen])
    factor = (hull.volume / fewer.volume) ** (1 / 3)
    return hull.center_mass + (corners[chosen] - hull.center_mass) * factor
