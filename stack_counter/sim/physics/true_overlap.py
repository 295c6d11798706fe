# SPDX-License-Identifier: Apache-2.0
"""Parts whose walls have gone through each other, found by their meshes.

The engine sees convex pieces alone. Here points of one part's surface are looked up in the exact
distance field of its neighbours: rings that are linked, or frames pushed through each other, have
points deep in each other's walls.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np
import trimesh
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from stack_counter.lean_open3d import o3d
from stack_counter.sim.scenes.scene import rotation_matrices
from stack_counter.sim.shapes import Shape


@dataclass(frozen=True)
class OverlapSettings:
    """Which parts are looked at, and how closely; chosen.

    Attributes:
        thin_below: mean wall below which parts are looked at, in part sizes: solid parts cannot
            go through each other unseen by the engine.
        crossing_depth: depth of a point in another part's wall from which the two have crossed,
            in mean walls. Half a wall is the deepest there is.
        points_per_wall: points of the surface on a square of one wall's side: by estimate
            walls that have crossed over one wall's length are missed in 3% of all cases.
        max_points: most points of a part.
        cluster_points: mean number of points that are looked up together first.
        grid_cells: cells of the coarse field along the part's largest side.
    """

    thin_below: float = 0.2
    crossing_depth: float = 0.35
    points_per_wall: float = 3.0
    max_points: int = 4000
    cluster_points: int = 50
    grid_cells: int = 40


SETTINGS = OverlapSettings()


def mean_wall(shape: Shape) -> float:
    """Mean thickness of a part's walls, 2 V / A, in part sizes."""
    return 2 * shape.unit_volume / float(shape.mesh.area) / shape.part_size


def count_crossings(shape: Shape, poses: np.ndarray) -> int:
    """Number of pairs of parts whose walls have gone through each other; 0 for solid parts.

    Args:
        shape: the part.
        poses: (n, 7) float64 position in metres and quaternion (x, y, z, w) of each part.
    """
    if mean_wall(shape) >= SETTINGS.thin_below:
        return 0
    probe = _make_probe(shape.vertices.tobytes(), shape.faces.tobytes())
    radius = float(np.linalg.norm(shape.vertices, axis=1).max())
    pairs = cKDTree(poses[:, :3]).query_pairs(2 * radius, output_type="ndarray")
    directed = np.concatenate([pairs, pairs[:, ::-1]])
    crossed = directed[probe.find_crossed(poses, directed)]
    return len(np.unique(np.sort(crossed, axis=1), axis=0))


@lru_cache(maxsize=2)  # scenes of the same part come one after the other
def _make_probe(vertices: bytes, faces: bytes) -> _Probe:
    return _Probe(trimesh.Trimesh(np.frombuffer(vertices).reshape(-1, 3),
                                  np.frombuffer(faces, np.int32).reshape(-1, 3), process=False))


class _Probe:
    """Surface points of a part in clusters, and its distance field, coarse and exact."""

    def __init__(self, mesh: trimesh.Trimesh):
        """Samples the surface and the coarse field of a mesh in metres."""
        wall = 2 * mesh.volume / mesh.area
        self._depth = SETTINGS.crossing_depth * wall
        # Points, sorted by cluster
        count = int(np.clip(SETTINGS.points_per_wall * mesh.area / wall**2, 100,
                            SETTINGS.max_points))
        points = trimesh.sample.sample_surface(mesh, count, seed=0)[0]
        centres, labels = kmeans2(points, max(count // SETTINGS.cluster_points, 1), minit="++",
                                  seed=0)
        self._points = points[np.argsort(labels, kind="stable")]
        self._labels = np.sort(labels)
        self._centres = centres
        self._radii = np.zeros(len(centres))
        np.maximum.at(self._radii, self._labels,
                      np.linalg.norm(self._points - centres[self._labels], axis=1))
        # Field
        self._field = o3d.t.geometry.RaycastingScene()
        self._field.add_triangles(o3d.core.Tensor(mesh.vertices.astype(np.float32)),
                                  o3d.core.Tensor(mesh.faces.astype(np.uint32)))
        self._low, self._high = mesh.bounds
        self._cell = float(np.ptp(mesh.bounds, axis=0).max()) / SETTINGS.grid_cells

    @cached_property
    def _grid(self) -> np.ndarray:
        """(i, j, k) float32 signed distances in the middles of the cells, metres."""
        cells = np.maximum(np.ceil((self._high - self._low) / self._cell), 1).astype(int)
        index = np.stack(np.meshgrid(*map(np.arange, cells), indexing="ij"), axis=-1)
        return self._signed_distance(self._low + (index + 0.5) * self._cell)

    def _signed_distance(self, points: np.ndarray) -> np.ndarray:
        """Exact signed distances of points (..., 3), metres, negative inside."""
        return self._field.compute_signed_distance(
            o3d.core.Tensor(points.astype(np.float32))).numpy()

    def _least_distance(self, points: np.ndarray) -> np.ndarray:
        """(n,) lower bounds of the signed distances of points (n, 3), metres."""
        inside = np.clip(points, self._low, self._high)
        beside = np.linalg.norm(points - inside, axis=1)
        cells = np.minimum(((inside - self._low) / self._cell).astype(int),
                           np.array(self._grid.shape) - 1)
        reach = np.linalg.norm(self._low + (cells + 0.5) * self._cell - points, axis=1)
        return np.where(beside > 0, np.maximum(beside, self._grid[tuple(cells.T)] - reach),
                        self._grid[tuple(cells.T)] - reach)

    def find_crossed(self, poses: np.ndarray, pairs: np.ndarray) -> np.ndarray:
        """(p,) bool: the first part of a pair (p, 2) has points deep in the second one's wall."""
        R, t = rotation_matrices(poses), poses[:, :3]
        a, b = pairs.T
        # First part's frame into the second one's
        turn = R[b].transpose(0, 2, 1) @ R[a]
        shift = np.einsum("pji,pj->pi", R[b], t[a] - t[b])
        # Whole clusters of points, then points by the coarse field, then by the exact one
        clusters = self._centres @ turn.transpose(0, 2, 1) + shift[:, None]  # (p, c, 3)
        near = self._least_distance(clusters.reshape(-1, 3)).reshape(clusters.shape[:2]) \
            - self._radii < -self._depth
        pair, point = np.nonzero(near[:, self._labels])
        placed = np.einsum("nij,nj->ni", turn[pair], self._points[point]) + shift[pair]
        deep = self._least_distance(placed) < -self._depth
        pair, placed = pair[deep], placed[deep]
        crossed = np.zeros(len(pairs), bool)
        crossed[pair[self._signed_distance(placed) < -self._depth]] = True
        return crossed
