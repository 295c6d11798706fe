# SPDX-License-Identifier: Apache-2.0
"""Convex pieces for the physics: a hull for convex parts, a decomposition for the others.

Hulls alone make concave parts stand too loose: they cannot nest. By how much,
`python -m stack_counter.sim.reality` prints.
"""

from __future__ import annotations

import multiprocessing
import resource
from dataclasses import dataclass
from functools import lru_cache
from multiprocessing.connection import Connection

import numpy as np
import trimesh

from stack_counter.child_processes import end_with_parent
from stack_counter.sim.shapes import Shape, ShapeError


@dataclass(frozen=True)
class CollisionSettings:
    """How finely concave parts are decomposed; chosen, if nothing else is said.

    Attributes:
        convex_from: V / V_hull from which a part is taken as convex.
        thresholds: concavity that a piece may keep (coacd), tried in this order.
        too_full: volume of the pieces over that of the part, above which a finer decomposition
            is tried.
        few_pieces: number of pieces up to which a finer decomposition is tried.
        max_pieces: largest number of pieces that a part may have.
        max_cpu_s: CPU seconds of one decomposition: some 3% of all meshes send coacd into an
            endless loop, the others take 1 to 5 s.
        hull_corners: most corners of a hull, the engine's limit.
        piece_corners: most corners of one piece of many: more bring time and little form.
        mcts_iterations, mcts_nodes, mcts_max_depth, resolution: the search that coacd makes for
            each cut: a sixth of its defaults, with pieces as full.
    """

    convex_from: float = 0.97
    thresholds: tuple[float, ...] = (0.08, 0.04, 0.02)
    too_full: float = 1.2
    few_pieces: int = 12
    max_pieces: int = 24
    max_cpu_s: int = 10
    hull_corners: int = 64
    piece_corners: int = 32
    mcts_iterations: int = 25
    mcts_nodes: int = 10
    mcts_max_depth: int = 2
    resolution: int = 600


SETTINGS = CollisionSettings()


def convex_pieces(shape: Shape, decompose: bool = True) -> list[np.ndarray]:
    """Corners (n, 3) float64, metres, of the convex pieces; at most 64 each.

    Args:
        shape: the part.
        decompose: False takes the hull of any part, as the paper does.

    Raises:
        ShapeError: `no decomposition`: no pieces in time, or too many.
    """
    if not decompose or shape.convexity > SETTINGS.convex_from:
        return [_hull_corners(shape.mesh, SETTINGS.hull_corners)]
    pieces = _finest_decomposition(shape.vertices.tobytes(), shape.faces.tobytes(),
                                   shape.unit_volume)
    if not 0 < len(pieces) <= SETTINGS.max_pieces:
        raise ShapeError(f"no decomposition: {len(pieces)} convex pieces within "
                         f"{SETTINGS.max_cpu_s} s; expected 1 to {SETTINGS.max_pieces}")
    return pieces


@lru_cache(maxsize=4)  # scenes of the same part come one after the other
def _finest_decomposition(vertices: bytes, faces: bytes, volume: float) -> list[np.ndarray]:
    """Corners (n, 3) of the finest decomposition of not too many pieces; none if there is none."""
    finest: list[trimesh.Trimesh] = []
    for threshold in SETTINGS.thresholds:
        pieces = _decompose_in_own_process(vertices, faces, threshold)
        if pieces and (not finest or len(pieces) <= SETTINGS.max_pieces):
            finest = pieces
        if not pieces or len(pieces) > SETTINGS.few_pieces \
                or sum(piece.volume for piece in pieces) < SETTINGS.too_full * volume:
            break
    return [_hull_corners(piece, SETTINGS.piece_corners) for piece in finest]


def _decompose_in_own_process(vertices: bytes, faces: bytes, threshold: float
                              ) -> list[trimesh.Trimesh]:
    """Hulls of the pieces, from a process of its own that may be lost; none if it is."""
    # From a server without threads: a fork of this process would inherit those of its libraries.
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload([__name__])
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send_decomposition,
                              args=(vertices, faces, threshold, sender))
    process.start()
    sender.close()
    try:
        pieces = receiver.recv()
    except EOFError:
        return []
    except BaseException:  # an interruption
        process.kill()
        raise
    finally:
        receiver.close()
        process.join()
    return [trimesh.Trimesh(*piece).convex_hull for piece in pieces]


def _send_decomposition(vertices: bytes, faces: bytes, threshold: float, sender: Connection
                        ) -> None:
    """Decomposes a mesh and sends the pieces' vertices and faces.

    The mesh has (n, 3) float64 vertices and (m, 3) int32 faces. The process is ended if it takes
    too long.
    """
    end_with_parent()
    # The processor's time, not the clock's: a busy machine gets the same pieces.
    resource.setrlimit(resource.RLIMIT_CPU, (SETTINGS.max_cpu_s, SETTINGS.max_cpu_s))
    import coacd  # here: only this needs it

    coacd.set_log_level("error")
    mesh = coacd.Mesh(np.frombuffer(vertices).reshape(-1, 3),
                      np.frombuffer(faces, np.int32).reshape(-1, 3))
    sender.send(coacd.run_coacd(
        mesh, threshold=threshold, preprocess_mode="off",
        mcts_iterations=SETTINGS.mcts_iterations, mcts_nodes=SETTINGS.mcts_nodes,
        mcts_max_depth=SETTINGS.mcts_max_depth, resolution=SETTINGS.resolution))


def _hull_corners(mesh: trimesh.Trimesh, limit: int) -> np.ndarray:
    """(n, 3) corners of the hull.

    If they are more than the limit, those farthest apart, blown up to the hull's volume.
    """
    hull = mesh.convex_hull
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
