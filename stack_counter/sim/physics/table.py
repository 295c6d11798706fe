# SPDX-License-Identifier: Apache-2.0
"""Pieces of a part lying apart on a table, each in one of its rest poses.

What a template scan sees.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.pose_packing import pack_poses, unpack_poses
from stack_counter.sim.scenes.scene import Scene
from stack_counter.sim.shapes import Shape


@dataclass(frozen=True)
class TableSettings:
    """How pieces lie on the table; chosen.

    Attributes:
        pitch: mean distance between the middles of neighbours, in part diagonals.
        play: largest distance of a piece from its place along x and y, in part diagonals.
        min_probability: probability below which a rest pose is left out.
    """

    pitch: float = 1.5
    play: float = 0.12
    min_probability: float = 0.01


SETTINGS = TableSettings()


def lay_out_pieces(shape: Shape, pieces: int, seed: int, index: int = 0) -> Scene:
    """Lays out so many pieces, dropped one by one beside each other.

    A piece dropped any way round comes to rest in a pose by that one's probability; no two poses
    are the same before all have come. Source: trimesh `compute_stable_poses`, after Goldberg et
    al., "Part Pose Statistics" (1999).
    """
    random = np.random.default_rng([seed, index, 0x5B])
    # A grid as square as possible
    diagonal = float(np.linalg.norm(np.ptp(shape.vertices, axis=0)))
    columns = int(np.ceil(np.sqrt(pieces)))
    rows = -(-pieces // columns)
    # One rest pose for each place, turned about the vertical at random
    rotations, probabilities = rest_rotations(shape)
    poses = []
    for i, chosen in enumerate(_draw_rest_poses(random, probabilities, pieces)):
        place = (np.array([i % columns, i // columns])
                 - (np.array([columns, rows]) - 1) / 2) * SETTINGS.pitch * diagonal
        place = place + random.uniform(-SETTINGS.play, SETTINGS.play, 2) * diagonal
        rotation = Rotation.from_rotvec([0, 0, random.uniform(0, 2 * np.pi)]) \
            * Rotation.from_matrix(rotations[chosen])
        lowest = float((shape.vertices @ rotation.as_matrix().T)[:, 2].min())
        poses.append([*place, -lowest, *rotation.as_quat()])
    side = max(columns, rows) * SETTINGS.pitch * diagonal
    table = ContainerShape("none", geometry.pose(np.eye(3), np.zeros(3)), (side, side, 0.0))
    return Scene(seed, index, shape, table, unpack_poses(pack_poses(np.array(poses))))


def _draw_rest_poses(random: np.random.Generator, probabilities: np.ndarray, pieces: int
                     ) -> list[int]:
    """Indices of rest poses: of pieces dropped, the user keeps turning them until all differ."""
    chosen: list[int] = []
    while len(chosen) < pieces:
        count = min(pieces - len(chosen), len(probabilities))
        chosen += random.choice(len(probabilities), count, replace=False,
                                p=probabilities).tolist()
    return chosen


def rest_rotations(shape: Shape) -> tuple[np.ndarray, np.ndarray]:
    """(n, 3, 3) rotations in which a part rests, the likeliest first, and (n,) probabilities."""
    transforms, probabilities = trimesh.poses.compute_stable_poses(
        shape.mesh.convex_hull, center_mass=np.zeros(3), n_samples=1)
    likely = probabilities >= min(SETTINGS.min_probability, probabilities.max())
    kept = probabilities[likely]
    return transforms[likely, :3, :3], kept / kept.sum()
