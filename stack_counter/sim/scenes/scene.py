"""A pile as it came to rest, its truth, and the ten bytes that each pose is packed in."""

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

_POSITION_STEPS, _TURN_STEPS = 65535, 1023
_ROUNDS = 6  # of packing after which a code repeats


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
        local = np.einsum("nij,vj->nvi", rotations(self.poses), base) + self.poses[:, None, :3]
        world = geometry.apply(self.container.T_world_container, local).reshape(-1, 3)
        offsets = (np.arange(n) * len(base))[:, None, None]
        return Mesh(world.astype(np.float32), (faces[None] + offsets).reshape(-1, 3).astype(
            np.int32))

    @cached_property
    def truth(self) -> Truth:
        """Count, V, gamma: see `measure_truth`."""
        return self.stored_truth or measure_truth(
            self.container, self.shape, self.parts_mesh(), self.poses, rotations(self.poses))


def rotations(poses: np.ndarray) -> np.ndarray:
    """(n, 3, 3) rotation matrices of (n, 7) poses."""
    x, y, z, w = poses[:, 3:].T
    return np.array([[1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
                     [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
                     [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)]]
                    ).transpose(2, 0, 1)


def pack(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Poses in ten bytes each; what `unpack` gave is packed as it was.

    Args:
        poses: (n, 7) float64 positions and unit quaternions (x, y, z, w).

    Returns:
        frame: (6,) float32, lowest corner and extent of the positions, metres.
        positions: (n, 3) uint16 in 65,535ths of the extent.
        turns: (n,) uint32: which component is the largest (2 bits), and the others in 1,023rds
            of their range of +-1/sqrt(2) (10 bits each); within 0.22 degrees.
    """
    low = poses[:, :3].min(axis=0, initial=np.inf) if len(poses) else np.zeros(3)
    extent = np.maximum(poses[:, :3].max(axis=0) - low, 1e-6) if len(poses) else np.ones(3)
    frame = np.concatenate([low, extent]).astype(np.float32)
    share = (poses[:, :3] - frame[:3]) / frame[3:]
    positions = np.round(np.clip(share, 0, 1) * _POSITION_STEPS).astype(np.uint16)
    # Where two components are nearly alike, rounding may make the other one the largest: two
    # codes then give each other. Of such a pair the smaller one stands for both.
    turns = _encoded(poses[:, 3:])
    for _ in range(_ROUNDS):
        turns = _encoded(_decoded(turns))
    return frame, positions, np.minimum(turns, _encoded(_decoded(turns)))


def _encoded(q: np.ndarray) -> np.ndarray:
    largest = np.argmax(np.abs(q), axis=1)
    sign = np.where(np.take_along_axis(q, largest[:, None], 1) < 0, -1, 1)
    others = (q * sign)[np.arange(4) != largest[:, None]].reshape(-1, 3)
    steps = np.round((np.clip(others * np.sqrt(0.5) + 0.5, 0, 1)) * _TURN_STEPS).astype(np.uint32)
    return (largest.astype(np.uint32) << 30) | (steps[:, 0] << 20) | (steps[:, 1] << 10) \
        | steps[:, 2]


def _decoded(turns: np.ndarray) -> np.ndarray:
    largest = (turns >> 30).astype(int)
    steps = np.stack([turns >> 20, turns >> 10, turns], axis=1) & 1023
    others = (steps / _TURN_STEPS - 0.5) * np.sqrt(2)
    q = np.empty((len(turns), 4))
    q[np.arange(4) != largest[:, None]] = others.ravel()
    q[np.arange(len(q)), largest] = np.sqrt(np.maximum(1 - np.sum(others**2, axis=1), 0))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def unpack(frame: np.ndarray, positions: np.ndarray, turns: np.ndarray) -> np.ndarray:
    """(n, 7) float64 poses from what `pack` returned."""
    frame = frame.astype(float)
    return np.concatenate([frame[:3] + positions / _POSITION_STEPS * frame[3:], _decoded(turns)],
                          axis=1)
