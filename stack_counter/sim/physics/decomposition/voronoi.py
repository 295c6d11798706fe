# SPDX-License-Identifier: Apache-2.0
"""A part cut along the Voronoi cells of its surface: never fails, in 0.3 to 3 seconds.

Its pieces are rougher than flat cuts, as no cell knows of edges.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh
from scipy.cluster.vq import kmeans2
from scipy.spatial import cKDTree

from stack_counter.sim.shapes.manifolds import make_manifold


@dataclass(frozen=True)
class VoronoiSettings:
    """How finely a part is cut; measured on tubes, tees, rings and toy bricks.

    Attributes:
        cells: number of cells. 200 make the merged pieces no better than 128, in 1.7 times the
            time; 64 are worse for toy bricks.
        points: points on the surface whose clusters give the cells.
        rounds: rounds of the clustering.
        seed: of points and clusters.
    """

    cells: int = 128
    points: int = 6000
    rounds: int = 15
    seed: int = 0


SETTINGS = VoronoiSettings()


def cut_voronoi(mesh: trimesh.Trimesh) -> list[np.ndarray]:
    """Corners (n, 3) float64 of the lumps into which the cells cut a solid.

    Raises:
        ShapeError: its faces make no solid.
    """
    solid = make_manifold(mesh)
    points, _ = trimesh.sample.sample_surface(mesh, SETTINGS.points, seed=SETTINGS.seed)
    centers, _ = kmeans2(np.asarray(points), SETTINGS.cells, SETTINGS.rounds, minit="++",
                         rng=SETTINGS.seed)
    centers = np.unique(centers[np.isfinite(centers).all(axis=1)], axis=0)
    distances, neighbours = cKDTree(centers).query(centers, k=len(centers))
    lumps = []
    for center, away, others in zip(centers, distances[:, 1:], centers[neighbours[:, 1:]],
                                    strict=True):
        # Cut by the plane half way to each other centre, from the nearest on
        cell = solid
        for distance, other in zip(away, others, strict=True):
            low, high = np.reshape(cell.bounding_box(), (2, 3))
            reach = np.linalg.norm(np.maximum(center - low, high - center))
            if cell.is_empty() or distance > 2 * reach:
                break
            normal = (center - other) / distance
            cell = cell.trim_by_plane(tuple(normal), float(normal @ (center + other)) / 2)
        lumps += [lump.to_mesh64().vert_properties[:, :3] for lump in cell.decompose()]
    return lumps
