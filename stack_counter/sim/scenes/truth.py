# SPDX-License-Identifier: Apache-2.0
"""The truth of a scene: count, v, V and gamma, exactly as `stack_volume` is defined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.sim.scenes.containers import ContainerShape, polygon_area
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.sim.shapes import Shape
from stack_counter.types import Mesh


@dataclass(frozen=True)
class TruthSettings:
    """How finely a scene's truth is integrated; chosen, and tested on closed forms.

    Attributes:
        cells_per_part: least number of cells of the height map along a part's size.
        points_per_part: about how many points inside a part stand for its volume where its share
            in the central box is measured.
    """

    cells_per_part: int = 20
    points_per_part: int = 256


SETTINGS = TruthSettings()


@dataclass(frozen=True)
class Truth:
    """What a scene holds.

    Attributes:
        count: number of parts.
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
                  rotations: np.ndarray) -> Truth:
    """Integrates the ideal height map.

    Args:
        container: the container in the world, or the region of a heap.
        shape: the part.
        parts: all parts, world frame.
        poses: (n, 7) poses of the parts in the container's frame.
        rotations: (n, 3, 3) their rotation matrices.
    """
    count, v = len(poses), shape.unit_volume
    low, high, area = _footprint(container, parts)
    xy = _cell_centers(low, high, shape.part_size, container.T_world_container)
    # Highest surface of the parts over every cell
    top, inner = RayCaster(parts).surface_heights(xy), container.inner_mesh()
    if inner is None:  # over the support plane, z = 0
        mean_height = float(np.maximum(top, 0).mean())
        return Truth(count, v, stack_volume=mean_height * area,
                     fill=mean_height / shape.part_size, gamma_whole=np.nan, gamma_center=np.nan)
    # Inner surface below every cell of the opening; the cells stand for its exact area
    floor = RayCaster(inner).surface_heights(xy)
    inside = np.isfinite(floor)
    mean_height = float(np.maximum(top[inside] - floor[inside], 0).mean())
    capacity = float((container.rim_height_m - floor[inside]).mean()) * area
    return Truth(count, v, stack_volume=mean_height * area,
                 fill=mean_height / container.inner_size_m[2], gamma_whole=count * v / capacity,
                 gamma_center=_central_gamma(container, shape, poses, rotations))


def _footprint(container: ContainerShape, parts: Mesh) -> tuple[np.ndarray, np.ndarray, float]:
    """Region of the integral, and the area that its cells stand for.

    Lowest and highest corner (2,), container frame, metres, and the area in m2.
    """
    if container.kind != "none":
        outline = container.opening
        return outline.min(axis=0), outline.max(axis=0), float(polygon_area(outline))
    T_container_world = geometry.inverse(container.T_world_container)
    points = geometry.apply(T_container_world, parts.vertices.astype(float))[:, :2]
    low, high = (points.min(axis=0), points.max(axis=0)) if len(points) \
        else np.array([[0, 0], [1, 1]])
    return low, high, float(np.prod(high - low))


def _cell_centers(low: np.ndarray, high: np.ndarray, part_size: float, T: np.ndarray
                  ) -> np.ndarray:
    """(rows, columns, 2) centres of the height map's cells, world, metres."""
    cells = np.ceil((high - low) * SETTINGS.cells_per_part / part_size).astype(int)
    rows, columns = np.mgrid[:cells[1], :cells[0]]
    centers = low + (np.stack([columns, rows], axis=-1) + 0.5) * (high - low) / cells
    return centers @ T[:2, :2].T + T[:2, 3]


def _central_gamma(container: ContainerShape, shape: Shape, poses: np.ndarray,
                   rotations: np.ndarray) -> float:
    """Share of the central half box that parts fill, from points spread inside each part."""
    points = sample_inside(shape, SETTINGS.points_per_part)
    placed = np.einsum("nij,pj->npi", rotations, points) + poses[:, None, :3]  # (n, points, 3)
    size = np.array(container.inner_size_m)
    middle = np.array([0, 0, container.floor_thickness_m + size[2] / 2])
    within = np.all(np.abs(placed - middle) < size / 4, axis=-1)
    return float(within.sum() / len(points) * shape.unit_volume / np.prod(size / 2))


def sample_inside(shape: Shape, count: int) -> np.ndarray:
    """(n, 3) points on a grid inside the part, its frame, metres; about `count` of them."""
    low, high = shape.vertices.min(axis=0), shape.vertices.max(axis=0)
    pitch = (shape.unit_volume / count) ** (1 / 3)
    cells = np.maximum(np.round((high - low) / pitch), 1).astype(int)
    axes = [start + (np.arange(n) + 0.5) * (end - start) / n
            for start, end, n in zip(low, high, cells)]
    grid = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    return grid[RayCaster(Mesh(shape.vertices.astype(np.float32), shape.faces)).contains(grid)]
