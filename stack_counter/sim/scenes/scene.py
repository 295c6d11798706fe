# SPDX-License-Identifier: Apache-2.0
"""A pile as it came to rest, and its truth."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from stack_counter import geometry
from stack_counter.errors import StackCounterError
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.truth import Truth, measure_truth
from stack_counter.sim.shapes import Shape
from stack_counter.types import Mesh


class SceneError(StackCounterError):
    """A stored scene is damaged, or a pile did not come to rest."""


@dataclass(frozen=True)
class Scene:
    """Parts at rest in or without a container; world frame with z up, support plane z = 0.

    Attributes:
        seed, index: what it was made from.
        shape: the part.
        container: the container, at its pose in the world.
        poses: (n, 7) float64: position in metres and quaternion (x, y, z, w) of each part in the
            container's frame.
        friction, restitution: coefficients of all contacts.
        taps: number of times that the container was shaken.
        stored_truth: the truth as read from a shard; None computes it from the poses.
    """

    seed: int
    index: int
    shape: Shape
    container: ContainerShape
    poses: np.ndarray
    friction: float = 0.0
    restitution: float = 0.0
    taps: int = 0
    stored_truth: Truth | None = None

    def parts_mesh(self) -> Mesh:
        """All parts as one mesh in the world; triangle i is of part i // len(shape.faces)."""
        vertices, faces = self.shape.vertices, self.shape.faces
        # Vertices of every part, (n, v, 3), in the container's frame, then in the world
        local = np.einsum("nij,vj->nvi", rotation_matrices(self.poses), vertices) \
            + self.poses[:, None, :3]
        world = geometry.apply(self.container.T_world_container, local).reshape(-1, 3)
        offsets = (np.arange(len(self.poses)) * len(vertices))[:, None, None]
        return Mesh(world.astype(np.float32),
                    (faces[None] + offsets).reshape(-1, 3).astype(np.int32))

    def part_poses(self) -> np.ndarray:
        """(n, 4, 4) float64 poses of the parts in the world."""
        T_container_parts = np.tile(np.eye(4), (len(self.poses), 1, 1))
        T_container_parts[:, :3, :3] = rotation_matrices(self.poses)
        T_container_parts[:, :3, 3] = self.poses[:, :3]
        return self.container.T_world_container @ T_container_parts

    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest corner (3,) of what parts and container span, world, metres."""
        points, container = self.parts_mesh().vertices.astype(float), self.container.mesh()
        points = points if container is None else np.concatenate([points, container.vertices])
        return points.min(axis=0), points.max(axis=0)

    @cached_property
    def truth(self) -> Truth:
        """Count, v, V and gamma, as `measure_truth` integrates them."""
        return self.stored_truth or measure_truth(
            self.container, self.shape, self.parts_mesh(), self.poses,
            rotation_matrices(self.poses))


def rotation_matrices(poses: np.ndarray) -> np.ndarray:
    """(n, 3, 3) float64 rotation matrices of (n, 7) poses."""
    x, y, z, w = poses[:, 3:].T
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
                    ).transpose(2, 0, 1)
