# SPDX-License-Identifier: Apache-2.0
"""The outer skin of a mesh that is not closed: what one who walks around it can reach.

Scans and the parts of LDraw are loose triangles. The skin closes gaps narrower than two cells of
a grid, and fills what lies behind them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from manifold3d import Manifold, Mesh
from scipy import ndimage

from stack_counter.lean_open3d import o3d


@dataclass(frozen=True)
class SkinSettings:
    """How fine the skin is.

    Attributes:
        cells: cells along the longest side. With 80, volumes of closed meshes after
            simplification to 1,500 triangles are measured 0.5% too small for blocks, 2% for tubes
            with walls of 1/20 of the size, 4% for walls of 1/40.
        clearance: distance from the mesh, in cells, beyond which cells connect freely: gaps of
            twice that are closed. Half a cell's diagonal at least; chosen.
        steps: cells that the outside is then followed towards the mesh, chosen.
        margin: cells around the mesh, chosen.
    """

    cells: int = 80
    clearance: float = 0.9
    steps: int = 2
    margin: int = 4


SETTINGS = SkinSettings()


def make_skin(mesh: trimesh.Trimesh, max_faces: int) -> Manifold:
    """Makes the closed outer skin of a mesh, simplified to so many triangles."""
    low, high = mesh.bounds
    cell = float((high - low).max()) / SETTINGS.cells
    count = np.ceil((high - low) / cell).astype(int) + 2 * SETTINGS.margin
    low = low - (SETTINGS.margin - 0.3) * cell  # off the planes of parts that lie along the axes
    grid = np.stack(np.meshgrid(*(low[k] + cell * np.arange(count[k]) for k in range(3)),
                                indexing="ij"), axis=-1).astype(np.float32)
    fine = _march(_signed_distance(mesh, grid, cell), low, cell).to_mesh64()
    coarse = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(np.array(fine.vert_properties)),
        o3d.utility.Vector3iVector(np.array(fine.tri_verts, np.int32))
    ).simplify_quadric_decimation(max_faces)
    return Manifold(Mesh(np.asarray(coarse.vertices, np.float32),
                         np.asarray(coarse.triangles, np.uint32)))


def _signed_distance(mesh: trimesh.Trimesh, grid: np.ndarray, cell: float) -> np.ndarray:
    """(x, y, z) distance of a grid's points (x, y, z, 3) to the mesh, negative inside."""
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(np.asarray(mesh.vertices, np.float32), np.asarray(mesh.faces, np.uint32))
    distance = scene.compute_distance(grid).numpy()
    # Away from the mesh: what is connected with a corner of the grid.
    labels, _ = ndimage.label(distance > SETTINGS.clearance * cell)
    outside = labels == labels[0, 0, 0]
    # Near it: what a step along an axis reaches from there without meeting it.
    links = []
    for axis in range(3):
        first, second = [slice(None)] * 3, [slice(None)] * 3
        first[axis], second[axis] = slice(None, -1), slice(1, None)
        step = np.broadcast_to(cell * np.eye(3, dtype=np.float32)[axis], grid.shape)
        hit = scene.cast_rays(np.concatenate([grid, step], axis=-1))["t_hit"].numpy() <= 1
        links.append((tuple(first), tuple(second), ~hit[tuple(first)]))
    for _ in range(SETTINGS.steps):
        grown = outside.copy()
        for first_of, second_of, free in links:
            grown[second_of] |= outside[first_of] & free
            grown[first_of] |= outside[second_of] & free
        outside = grown
    return np.where(outside, distance, -distance)


def _march(signed: np.ndarray, low: np.ndarray, cell: float) -> Manifold:
    """The surface where a field (x, y, z) on a grid from `low` on is zero."""
    bounds = [*low, *(low + cell * (np.array(signed.shape) - 1))]
    # Asked once for where it wants values and once for these: all at once is faster.
    points: list[tuple[float, float, float]] = []

    def note(x: float, y: float, z: float) -> float:
        points.append((x, y, z))
        return -1.0

    Manifold.level_set(note, bounds, cell, 0.0)
    values = iter((-ndimage.map_coordinates(
        signed, (np.array(points) - low).T / cell, order=1, mode="nearest")).tolist())
    return Manifold.level_set(lambda x, y, z: next(values), bounds, cell, 0.0)
