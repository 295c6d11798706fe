"""Colours of a mesh from the pictures that show it."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.types import Mesh, View

_MOST_VIEWS = 6  # looked at, evenly spread over the scan
_CLOSE = 0.01  # how near the seen surface a vertex must be, m
_GREY = 128  # of what no picture shows


def display_colors(mesh: Mesh) -> np.ndarray:
    """(n, 3) uint8 RGB of the vertices, one or more: their own, or dark to bright by height."""
    if mesh.colors is not None:
        return mesh.colors
    z = mesh.vertices[:, 2]
    height = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    return cv2.applyColorMap((255 * height).astype(np.uint8)[:, None],
                             cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]


def color_mesh(mesh: Mesh, views: list[View]) -> Mesh:
    """The mesh with the mean colour that views with depth and colour show of each vertex; as it
    was if none has colour."""
    views = [v for v in views if v.color is not None and v.depth is not None]
    if not views:
        return mesh
    total, seen = np.zeros((len(mesh.vertices), 3)), np.zeros(len(mesh.vertices))
    for i in np.unique(np.linspace(0, len(views) - 1, _MOST_VIEWS).round().astype(int)):
        view = views[i]
        assert view.color is not None and view.depth is not None  # chosen above
        pixels = geometry.project_into(view, mesh.vertices)
        shown = np.abs(view.depth[pixels.rows, pixels.cols] - pixels.depth) < _CLOSE
        index = np.flatnonzero(pixels.inside)[shown]
        total[index] += view.color[pixels.rows[shown], pixels.cols[shown]]
        seen[index] += 1
    mean = np.where(seen[:, None] > 0, total / np.maximum(seen, 1)[:, None], _GREY)
    return replace(mesh, colors=mean.round().astype(np.uint8))
