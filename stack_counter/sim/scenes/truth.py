"""The truth of a scene: count, v, V and gamma, exactly as `stack_volume` is defined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.shapes import Shape
from stack_counter.types import Mesh

_CELLS = 20  # at least, for a part's size
_POINTS = 256  # inside a part, by which its share in the central box is known


@dataclass(frozen=True)
class Truth:
    """What a scene holds.

    Attributes:
        count: parts.
        unit_volume: v of the part's mesh, m3.
        stack_volume: V, m3: the integral over the rim opening (heap: the support plane) of what
            the ideal view from above sees over the inner surface.
        fill: mean height of the stack over the container's depth; over the part's size for a
            heap.
        gamma_whole: the paper's ratio with borders, over the container's whole inside; NaN for a
            heap.
        gamma_center: its ratio without borders, in a box of half the sides in the middle of the
            inside; NaN for a heap. Source: paper, supplement, "Border Effects".
    """

    count: int
    unit_volume: float
    stack_volume: float
    fill: float
    gamma_whole: float
    gamma_center: float

    @property
    def gamma(self) -> float:
        """Occupancy ratio; NaN for an empty scene."""
        return self.count * self.unit_volume / self.stack_volume if self.count else float("nan")


def measure_truth(container: ContainerShape, shape: Shape, parts: Mesh, poses: np.ndarray,
                  turns: np.ndarray) -> Truth:
    """Integrates the ideal height map.

    Args:
        container: in the world.
        parts: all parts, world frame.
        poses: (n, 7) of the parts in the container's frame; `turns` (n, 3, 3) their rotations.
    """
    T, count, v = container.T_world_container, len(poses), shape.unit_volume
    if container.kind == "none":
        local = geometry.apply(geometry.inverse(T), parts.vertices.astype(float))[:, :2]
        low, high = (local.min(axis=0), local.max(axis=0)) if count else np.array([[0, 0], [1, 1]])
        area = float(np.prod(high - low))
    else:
        low, high = container.opening.min(axis=0), container.opening.max(axis=0)
        area = _area(container.opening)
    cells = np.ceil((high - low) * _CELLS / shape.part_size).astype(int)
    rows, cols = np.mgrid[:cells[1], :cells[0]]
    centres = low + (np.stack([cols, rows], axis=-1) + 0.5) * (high - low) / cells
    xy = centres @ T[:2, :2].T + T[:2, 3]
    top, inner = RayCaster(parts).surface_heights(xy), container.inner_mesh()
    if inner is None:
        mean = float(np.maximum(top, 0).mean())
        return Truth(count, v, mean * area, mean / shape.part_size, np.nan, np.nan)
    floor = RayCaster(inner).surface_heights(xy)
    inside = np.isfinite(floor)  # cells of the opening; they stand for its exact area
    mean = float(np.maximum(top[inside] - floor[inside], 0).mean())
    capacity = float((container.rim_height_m - floor[inside]).mean()) * area
    return Truth(count, v, mean * area, mean / container.inner_size_m[2], count * v / capacity,
                 _central_gamma(container, shape, poses, turns))


def _area(outline: np.ndarray) -> float:
    (x, y), (u, w) = outline.T, np.roll(outline, -1, axis=0).T
    return float(np.sum(x * w - u * y)) / 2


def _central_gamma(container: ContainerShape, shape: Shape, poses: np.ndarray, turns: np.ndarray
                  ) -> float:
    """Share of the central half box that parts fill, from points spread inside each part."""
    points = sample_inside(shape, _POINTS)
    placed = np.einsum("nij,pj->npi", turns, points) + poses[:, None, :3]
    size = np.array(container.inner_size_m)
    middle = np.array([0, 0, container.floor_thickness_m + size[2] / 2])
    within = np.all(np.abs(placed - middle) < size / 4, axis=-1)
    return float(within.sum() / len(points) * shape.unit_volume / np.prod(size / 2))


def sample_inside(shape: Shape, count: int) -> np.ndarray:
    """(n, 3) points on a grid inside the part, its frame, metres; about `count` of them."""
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    pitch = (shape.unit_volume / count) ** (1 / 3)
    sides = np.maximum(np.round((high - low) / pitch), 1).astype(int)
    axes = [a + (np.arange(n) + 0.5) * (b - a) / n for a, b, n in zip(low, high, sides)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[RayCaster(Mesh(shape.vertices.astype(np.float32), shape.faces)).contains(grid)]
