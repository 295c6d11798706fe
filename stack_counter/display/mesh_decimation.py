"""Fewer triangles for display, by joining the vertices of a cell."""

from __future__ import annotations

import numpy as np

from stack_counter.types import Mesh

_GROWTH = 1.2  # of the cell's side, while there are still too many triangles
_FINEST = 1e-4  # side of a cell, m


def decimated(mesh: Mesh, most: int) -> Mesh:
    """The mesh with at most so many triangles; as it is if it has no more.

    All vertices of a cubic cell become one in their middle, of their mean colour. That blurs what
    is smaller than a cell; nothing is measured on it.
    """
    if len(mesh.triangles) <= most:
        return mesh
    a, b = mesh.vertices[mesh.triangles[:, 0]], mesh.vertices[mesh.triangles[:, 1]]
    # A surface of as many triangles needs edges longer by the root of what there are too many.
    side = float(np.median(np.linalg.norm(a - b, axis=1)))
    side *= (len(mesh.triangles) / max(most, 1)) ** 0.5
    while True:
        joined = _joined(mesh, max(side, _FINEST))
        if len(joined.triangles) <= most:
            return joined
        side *= _GROWTH


def _joined(mesh: Mesh, side: float) -> Mesh:
    """The mesh with one vertex for each cell of that side, metres."""
    cells = np.floor((mesh.vertices - mesh.vertices.min(axis=0)) / side).astype(np.int64)
    _, rows, columns = cells.max(axis=0) + 1
    _, cell, count = np.unique((cells[:, 0] * rows + cells[:, 1]) * columns + cells[:, 2],
                               return_inverse=True, return_counts=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.stack([np.bincount(cell, v) for v in values.T], axis=1) / count[:, None]

    triangles = cell[mesh.triangles].astype(np.int32)
    a, b, c = triangles.T
    triangles = triangles[(a != b) & (b != c) & (c != a)]  # the others have shrunk to a line
    colors = None if mesh.colors is None else mean(mesh.colors).round().astype(np.uint8)
    return Mesh(mean(mesh.vertices).astype(np.float32), triangles, colors)
