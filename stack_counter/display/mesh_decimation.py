# SPDX-License-Identifier: Apache-2.0
"""Fewer triangles for display, by joining the vertices of a cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.types import Mesh


@dataclass(frozen=True)
class DecimationSettings:
    """How cells are sized; all chosen: nothing is measured on a decimated mesh.

    Attributes:
        growth: factor by which the cells' side grows while there are too many triangles.
        min_cell_m: smallest side of a cell, m.
    """

    growth: float = 1.2
    min_cell_m: float = 1e-4


SETTINGS = DecimationSettings()


def decimate(mesh: Mesh, max_triangles: int) -> Mesh:
    """Returns the mesh with at most `max_triangles`; as it is if it has no more.

    All vertices of a cubic cell become one in their middle, of their mean colour. That blurs what
    is smaller than a cell; nothing is measured on it.
    """
    if len(mesh.triangles) <= max_triangles:
        return mesh
    # Start with cells as large as the edges of a surface of so few triangles.
    a, b = mesh.vertices[mesh.triangles[:, 0]], mesh.vertices[mesh.triangles[:, 1]]
    side = float(np.median(np.linalg.norm(a - b, axis=1)))
    side *= (len(mesh.triangles) / max(max_triangles, 1)) ** 0.5
    # Enlarge the cells until few enough triangles are left.
    while True:
        clustered = _cluster_vertices(mesh, max(side, SETTINGS.min_cell_m))
        if len(clustered.triangles) <= max_triangles:
            return clustered
        side *= SETTINGS.growth


def _cluster_vertices(mesh: Mesh, side: float) -> Mesh:
    """Returns the mesh with one vertex for each cubic cell of `side` metres."""
    # Number the cells that hold vertices.
    cells = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / side).astype(np.int64)
    _, rows, columns = cells.max(axis=0) + 1
    _, cell, count = np.unique((cells[:, 0] * rows + cells[:, 1]) * columns + cells[:, 2],
                               return_inverse=True, return_counts=True)

    def cell_means(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cell, v) for v in values.T], axis=1) / count[:, None]

    # Keep the triangles that have not shrunk to a line.
    triangles = cell[mesh.triangles].astype(np.int32)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]
    colors = None if mesh.colors is None else cell_means(mesh.colors).round().astype(np.uint8)
    return Mesh(cell_means(mesh.vertices).astype(np.float32), triangles, colors)
