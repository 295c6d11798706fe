"""Pieces of a part lying apart on a table, each in one of its rest poses: what a template scan
sees."""

from __future__ import annotations

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene
from stack_counter.sim.shapes import Shape

_APART = 1.5  # part diagonals between the middles of neighbours, on average
_PLAY = 0.12  # part diagonals by which each lies off its place
_RARE = 0.01  # probability below which a rest pose is left out


def lay_out_pieces(shape: Shape, pieces: int, seed: int, index: int = 0) -> Scene:
    """So many pieces, dropped one by one beside each other.

    A piece dropped any way round comes to rest in a pose by that one's probability; no two poses
    are the same before all have come. Source: trimesh `compute_stable_poses`, after Goldberg et
    al., "Part Pose Statistics" (1999).
    """
    random = np.random.default_rng([seed, index, 0x5B])
    diagonal = float(np.linalg.norm(np.ptp(shape.vertices, axis=0)))
    columns = int(np.ceil(np.sqrt(pieces)))
    rows = -(-pieces // columns)
    turns, weights = rest_rotations(shape)
    chosen = _chosen(random, weights, pieces)
    poses = []
    for i, k in enumerate(chosen):
        place = (np.array([i % columns, i // columns])
                 - (np.array([columns, rows]) - 1) / 2) * _APART * diagonal
        place = place + random.uniform(-_PLAY, _PLAY, 2) * diagonal
        turn = Rotation.from_rotvec([0, 0, random.uniform(0, 2 * np.pi)]) \
            * Rotation.from_matrix(turns[k])
        lowest = float((shape.vertices @ turn.as_matrix().T)[:, 2].min())
        poses.append([*place, -lowest, *turn.as_quat()])
    side = max(columns, rows) * _APART * diagonal
    ground = ContainerShape("none", geometry.pose(np.eye(3), np.zeros(3)), (side, side, 0.0))
    return Scene(seed, index, shape, ground, unpack_poses(pack_poses(np.array(poses))))


def _chosen(random: np.random.Generator, weights: np.ndarray, pieces: int) -> list[int]:
    """Rest poses: of so many pieces dropped, the user keeps turning them until all differ."""
    out: list[int] = []
    while len(out) < pieces:
        count = min(pieces - len(out), len(weights))
        out += random.choice(len(weights), count, replace=False, p=weights).tolist()
    return out


def rest_rotations(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3, 3) rotations in which a part rests, the likeliest first, and their probabilities."""
    places, chances = trimesh.poses.compute_stable_poses(
        shape.mesh.convex_hull, center_mass=np.zeros(3), n_samples=1)
    likely = chances >= min(_RARE, chances.max())
    return places[likely, :3, :3], chances[likely] / chances[likely].sum()
