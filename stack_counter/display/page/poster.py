# SPDX-License-Identifier: Apache-2.0
"""A picture of the model, for paper and for readers without script or 3D."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.types import Mesh


@dataclass(frozen=True)
class PosterSettings:
    """How the model is looked at and lit; all chosen.

    Attributes:
        size_px: width and height of the picture.
        oversampling: it is drawn so many times larger, and then reduced: smooth edges.
        azimuth_deg: from where the eye looks: angle about z from the stack's own -y axis.
        polar_deg: angle of the eye from straight above.
        field_of_view_deg: vertical, as that of the page's viewer.
        fill: share of the picture that the model fills.
        light: (3,) direction from which light comes, turned with the eye: right, up, towards it.
        ambient: share of the colour that shows in the shade.
    """

    size_px: tuple[int, int] = (960, 720)
    oversampling: int = 2
    azimuth_deg: float = 35.0
    polar_deg: float = 44.0
    field_of_view_deg: float = 30.0
    fill: float = 0.96
    light: tuple[float, float, float] = (-0.35, 0.85, 0.4)
    ambient: float = 0.62


SETTINGS = PosterSettings()


def draw_poster(meshes: Iterable[Mesh], yaw: float) -> np.ndarray:
    """Draws meshes with colours obliquely from above.

    Args:
        meshes: with colours, world frame.
        yaw: angle from the world's x axis to the stack's own, rad.

    Returns:
        (h, w, 4) uint8 BGRA, transparent where there is nothing.
    """
    meshes = list(meshes)
    vertices = np.concatenate([mesh.vertices for mesh in meshes]).astype(float)
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    triangles = np.concatenate([m.triangles + start for m, start in zip(meshes, starts)])
    colors = np.concatenate([mesh.colors for mesh in meshes if mesh.colors is not None])
    local = _in_eye(vertices, yaw)
    pixels = _project(local)
    # Shade the triangles, and draw far ones first.
    corners = local[triangles]  # (m, 3, 3)
    shades = colors[triangles].mean(axis=1) * _light(corners)[:, None]
    order = np.argsort(-corners[..., 2].max(axis=1))
    width, height = SETTINGS.size_px
    scale = SETTINGS.oversampling
    picture = np.zeros((height * scale, width * scale, 4), np.uint8)
    shapes = np.round(pixels[triangles] * scale * 16).astype(np.int32)[order]
    fills = np.column_stack([shades[order][:, ::-1], np.full(len(order), 255)]).tolist()
    for shape, fill in zip(shapes, fills):
        cv2.fillConvexPoly(picture, shape, fill, cv2.LINE_8, 4)
    return cv2.resize(picture, SETTINGS.size_px, interpolation=cv2.INTER_AREA)


def _in_eye(vertices: np.ndarray, yaw: float) -> np.ndarray:
    """Returns (n, 3) points in the optical frame of the eye, which looks at their middle."""
    azimuth = np.deg2rad(SETTINGS.azimuth_deg - 90) + yaw
    polar = np.deg2rad(SETTINGS.polar_deg)
    away = np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth),
                     np.cos(polar)])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    middle, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2
    distance = radius / np.sin(np.deg2rad(SETTINGS.field_of_view_deg) / 2)
    T_world_eye = geometry.look_at(middle + distance * away, middle)
    return geometry.apply(geometry.inverse(T_world_eye), vertices)


def _project(local: np.ndarray) -> np.ndarray:
    """Returns (n, 2) pixels of points in the eye's frame, scaled to fill the picture."""
    flat = local[:, :2] / local[:, 2:]
    low, high = flat.min(axis=0), flat.max(axis=0)
    size = np.array(SETTINGS.size_px)
    scale = SETTINGS.fill * float((size / np.maximum(high - low, 1e-9)).min())
    return (flat - (low + high) / 2) * scale + size / 2


def _light(corners: np.ndarray) -> np.ndarray:
    """Returns (m,) how bright triangles (m, 3, 3) of the eye's frame are: ambient to 1."""
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-12)
    normals *= np.where((normals * corners.mean(axis=1)).sum(axis=1) > 0, -1, 1)[:, None]
    right, up, near = SETTINGS.light
    light = np.array([right, -up, -near]) / np.linalg.norm(SETTINGS.light)
    return SETTINGS.ambient + (1 - SETTINGS.ambient) * np.clip(normals @ light, 0, 1)
