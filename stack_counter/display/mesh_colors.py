# SPDX-License-Identifier: Apache-2.0
"""Colours of a mesh from the pictures that show it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.types import Mesh, View, spread_views


@dataclass(frozen=True)
class MeshColorSettings:
    """How a mesh takes its colours; all chosen: nothing is measured on them.

    Attributes:
        max_views: number of views that colours are taken from, evenly spread over the scan.
        max_distance_m: distance along the optical axis between a vertex and the depth measured
            at its pixel up to which the view shows it.
        unseen_grey: grey level of what no picture shows.
    """

    max_views: int = 6
    max_distance_m: float = 0.01
    unseen_grey: int = 128


SETTINGS = MeshColorSettings()


def display_colors(mesh: Mesh) -> np.ndarray:
    """Returns (n, 3) uint8 RGB of one or more vertices: their own, or dark to bright by height."""
    if mesh.colors is not None:
        return mesh.colors
    z = mesh.vertices[:, 2]
    height = (z - z.min()) / max(float(np.ptp(z)), 1e-9)
    return cv2.applyColorMap((255 * height).astype(np.uint8)[:, None],
                             cv2.COLORMAP_VIRIDIS)[:, 0, ::-1]


def color_mesh(mesh: Mesh, views: list[View]) -> Mesh:
    """Returns the mesh with the mean colour that the views show of each vertex.

    Args:
        mesh: vertices in the world.
        views: those without depth or colour are left out; with none left the mesh stays as it is.
    """
    views = [v for v in views if v.color is not None and v.depth is not None]
    if not views:
        return mesh
    # Sum the colours of every vertex over the views that show it.
    total = np.zeros((len(mesh.vertices), 3), np.float32)
    views_seeing = np.zeros(len(mesh.vertices), np.float32)
    for view in spread_views(views, SETTINGS.max_views):
        assert view.color is not None and view.depth is not None  # for the type checker
        pixels = geometry.project_into(view, mesh.vertices, np.float32)
        off = np.abs(view.depth[pixels.rows, pixels.cols] - pixels.depth)
        shown = off < SETTINGS.max_distance_m
        index = np.flatnonzero(pixels.inside)[shown]
        total[index] += view.color[pixels.rows[shown], pixels.cols[shown]]
        views_seeing[index] += 1
    # Take their mean.
    mean = np.where(views_seeing[:, None] > 0, total / np.maximum(views_seeing, 1)[:, None],
                    SETTINGS.unseen_grey)
    return replace(mesh, colors=mean.round().astype(np.uint8))
