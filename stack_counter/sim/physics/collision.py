"""Convex pieces for the physics: a hull for convex parts, a decomposition for the others.

Hulls alone make concave parts stand too loose: they cannot nest.
"""

from __future__ import annotations

import multiprocessing
import resource
from functools import lru_cache
from multiprocessing.connection import Connection

import numpy as np
import trimesh

from stack_counter.sim.shapes import Shape, ShapeError

_CONVEX = 0.97  # V / V_hull from which a part is taken as convex
_THRESHOLDS = (0.08, 0.04, 0.02)  # concavity that a piece may keep (coacd), tried in this order
_TOO_FULL = 1.2  # volume of the pieces over that of the part, above which a finer one is tried
_FEW, _MANY = 12, 24  # pieces up to which a finer one is tried; most that a part may have
_CPU_S = 10  # some 3% of all meshes send coacd into an endless loop; the others take 1 to 5 s
_CORNERS = 64  # of a hull: the engine's limit
_PIECE_CORNERS = 32  # of one piece of many: more bring time and little form
# The search that coacd makes for each cut: a sixth of its defaults, with pieces as full.
_SEARCH = {"preprocess_mode": "off", "mcts_iterations": 25, "mcts_nodes": 10,
           "mcts_max_depth": 2, "resolution": 600}


def convex_pieces(shape: Shape, decompose: bool = True) -> list[np.ndarray]:
    """Corners (n, 3) float64, metres, of the convex pieces; at most 64 each.

    Args:
        decompose: False takes the hull of any part, as the paper does.

    Raises:
        ShapeError: `no decomposition`.
    """
    if not decompose or shape.convexity > _CONVEX:
        return [_limited(shape.mesh)]
    best = _decomposed(shape.vertices.tobytes(), shape.faces.tobytes(), shape.unit_volume)
    if not 0 < len(best) <= _MANY:
        raise ShapeError(f"no decomposition: {len(best)} convex pieces within {_CPU_S} s; "
                         f"expected 1 to {_MANY}")
    return best


@lru_cache(maxsize=4)  # scenes of the same part come one after the other
def _decomposed(vertices: bytes, faces: bytes, volume: float) -> list[np.ndarray]:
    """The finest decomposition of not too many pieces; none if there is none."""
    best: list[trimesh.Trimesh] = []
    for threshold in _THRESHOLDS:
        pieces = _isolated(vertices, faces, threshold)
        if pieces and (not best or len(pieces) <= _MANY):
            best = pieces
        if not pieces or len(pieces) > _FEW or sum(p.volume for p in pieces) < _TOO_FULL * volume:
            break
    return [_limited(piece, _PIECE_CORNERS) for piece in best]


def _isolated(vertices: bytes, faces: bytes, threshold: float) -> list[trimesh.Trimesh]:
    """Hulls of the pieces, from a process of its own that may be lost; none if it is."""
    # From a server without threads: a fork of this process would inherit those of its libraries.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    ours, theirs = context.Pipe(duplex=False)
    process = context.Process(target=_decompose, args=(vertices, faces, threshold, theirs))
    process.start()
    theirs.close()
    try:
        pieces = ours.recv()
    except EOFError:
        return []
    finally:
        ours.close()
        process.join()
    return [trimesh.Trimesh(*piece).convex_hull for piece in pieces]


def _decompose(vertices: bytes, faces: bytes, threshold: float, out: Connection) -> None:
    # Of the processor's time, not the clock's: a busy machine gets the same pieces.
    resource.setrlimit(resource.RLIMIT_CPU, (_CPU_S, _CPU_S))
    import coacd  # here: only this needs it

    coacd.set_log_level("error")
    mesh = coacd.Mesh(np.frombuffer(vertices).reshape(-1, 3),
                      np.frombuffer(faces, np.int32).reshape(-1, 3))
    out.send(coacd.run_coacd(mesh, threshold=threshold, **_SEARCH))


def _limited(mesh: trimesh.Trimesh, limit: int = _CORNERS) -> np.ndarray:
    """Corners of the hull; of more than the limit the farthest apart, blown up to its volume."""
    hull = mesh.convex_hull
    corners = np.asarray(hull.vertices)
    if len(corners) <= limit:
        return corners
    chosen = [int(np.argmax(np.linalg.norm(corners - hull.center_mass, axis=1)))]
    distance = np.full(len(corners), np.inf)
    while len(chosen) < limit:
        distance = np.minimum(distance, np.linalg.norm(corners - corners[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    fewer = trimesh.convex.convex_hull(corners[chosen])
    factor = (hull.volume / fewer.volume) ** (1 / 3)
    return hull.center_mass + (corners[chosen] - hull.center_mass) * factor
