"""A pile as it came to rest, and its file."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.errors import StackCounterError
from stack_counter.sim.shapes import Shape
from stack_counter.types import Container, Mesh


class SceneError(StackCounterError):
    """A scene file is damaged, or a pile did not come to rest."""


@dataclass(frozen=True)
class Scene:
    """Parts at rest in or without a container, world frame, z up, support plane z = 0.

    Attributes:
        seed, index: what it was made from.
        shape: the part.
        container: kind `box` or `none`.
        poses: (n, 7) float32: position in metres and quaternion (x, y, z, w) of each part.
    """

    seed: int
    index: int
    shape: Shape
    container: Container
    poses: np.ndarray

    def parts_mesh(self) -> Mesh:
        """All parts as one mesh; triangle i belongs to part i // len(shape.faces)."""
        base = self.shape.vertices
        placed = [geometry.apply(geometry.pose_from_quaternion(p[3:], p[:3]), base)
                  for p in self.poses.astype(float)]
        faces = [self.shape.faces + i * len(base) for i in range(len(placed))]
        if not placed:
            return Mesh(np.zeros((0, 3), np.float32), np.zeros((0, 3), np.int32))
        return Mesh(np.concatenate(placed).astype(np.float32),
                    np.concatenate(faces).astype(np.int32))

    def save(self, path: Path) -> None:
        """Writes an .npz; a crash leaves no half file."""
        box, half = self.container, path.with_suffix(".part")
        with open(half, "wb") as file:
            np.savez_compressed(
                file, seed=self.seed, index=self.index, family=self.shape.family,
                vertices=self.shape.vertices, faces=self.shape.faces, poses=self.poses,
                kind=box.kind, T_world_container=box.T_world_container,
                inner_size_m=box.inner_size_m,
                thickness_m=[box.wall_thickness_m, box.floor_thickness_m])
        os.replace(half, path)


def load_scene(path: Path) -> Scene:
    """Reads a scene.

    Raises:
        SceneError: damaged or not a scene.
    """
    try:
        with np.load(path, allow_pickle=False) as f:
            wall, floor = f["thickness_m"].tolist()
            size = f["inner_size_m"].tolist()
            container = Container(str(f["kind"]), f["T_world_container"],
                                  (size[0], size[1], size[2]), wall, floor)
            return Scene(int(f["seed"]), int(f["index"]),
                         Shape(str(f["family"]), f["vertices"], f["faces"]), container, f["poses"])
    except FileNotFoundError:
        raise
    except Exception as error:  # numpy's and zipfile's own differ by the kind of damage
        raise SceneError(f"{path} is no whole scene: {error}") from error
