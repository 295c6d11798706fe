"""The truth of a scene: count, v, V and gamma, exactly as `stack_volume` is defined."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter import geometry
from stack_counter.sim.scene import Scene
from stack_counter.tsdf import TopView

_PITCH = 1 / 20  # of the part size


@dataclass(frozen=True)
class Truth:
    """count; unit and stack volume in m3; gamma = count * unit_volume / stack_volume."""

    count: int
    unit_volume: float
    stack_volume: float

    @property
    def gamma(self) -> float:
        """Occupancy ratio."""
        return self.count * self.unit_volume / self.stack_volume


def truth_of(scene: Scene) -> Truth:
    """Integrates the ideal height map over the rim opening, or over the support plane."""
    box, mesh = scene.container, scene.parts_mesh()
    local = geometry.apply(geometry.inverse(box.T_world_container), mesh.vertices.astype(float))
    if box.kind == "box":
        low, high = -np.array(box.inner_size_m[:2]) / 2, np.array(box.inner_size_m[:2]) / 2
    else:
        low, high = local[:, :2].min(axis=0), local[:, :2].max(axis=0)
    cells = np.ceil((high - low) / (_PITCH * scene.shape.part_size)).astype(int)
    # One pitch for both sides: the cells cover the opening, and the mean is taken over it.
    pitch = float(((high - low) / cells).min())
    cells = np.floor((high - low) / pitch + 1e-9).astype(int)
    rest = (high - low - cells * pitch) / 2
    T = box.T_world_container @ geometry.pose(np.eye(3), np.array([*(low + rest), 0.0]))
    top = TopView(mesh).heights(T, pitch, (int(cells[1]), int(cells[0])))
    heights = np.maximum(np.nan_to_num(top.heights, nan=0.0) - box.floor_thickness_m, 0)
    area = float(np.prod(high - low))
    mean = float(heights.mean(dtype=float))
    return Truth(len(scene.poses), scene.shape.unit_volume, mean * area)
