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
        container: its pose is that in the world.
        poses: (n, 7) float64: position in metres and quaternion (x, y, z, w) of each part in the
            container's frame.
        friction, restitution: of the contacts.
        taps: how often the container was shaken.
        stored_truth: as read from a shard; None computes it from the poses.
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
        n, base, faces = len(self.poses), self.shape.vertices, self.shape.faces
        local = (
            np.einsum("nij,vj->nvi", rotation_matrices(self.poses), base) + self.poses[:, None, :3]
        )
        world = geometry.apply(self.container.T_world_container, local).reshape(-1, 3)
        offsets = (np.arange(n) * len(base))[:, None, None]
        return Mesh(world.astype(np.float32), (faces[None] + offsets).reshape(-1, 3).astype(
            np.int32))

    @cached_property
    def truth(self) -> Truth:
        """Count, V, gamma: see `measure_truth`."""
        return self.stored_truth or measure_truth(
            self.container,
            self.shape,
            self.parts_mesh(),
            self.poses,
            rotation_matrices(self.poses),
        )


def rotation_matrices(poses: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotation matrices of (n, 7) poses."""
    x, y, z, w = poses[:, 3:].T
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
                    ).transpose(2, 0, 1)
