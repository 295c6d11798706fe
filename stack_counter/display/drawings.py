# SPDX-License-Identifier: Apache-2.0
"""Pictures of what was measured, and the surface as a file that mesh viewers open."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.types import CONTAINER, PARTS, UNSEEN, Container, HeightMap, KeyView, Mesh


@dataclass(frozen=True)
class DrawingSettings:
    """How drawings look; all chosen.

    Attributes:
        width_px: least width of a picture of a map, pixels.
        tint_share: share of the tint in the colour of a labelled pixel, 0 to 1.
        container_scale: how many times larger than the key view its container is drawn.
        wall_lines: about so many lines are drawn between rim and floor.
    """

    width_px: int = 640
    tint_share: float = 0.4
    container_scale: int = 2
    wall_lines: int = 12


SETTINGS = DrawingSettings()

# Tints of labels, BGR: of Okabe and Ito, which those who see no red or green tell apart.
LABEL_TINTS = {PARTS: (178, 114, 0), CONTAINER: (0, 159, 230)}
_RED, _BLUE, _YELLOW = (0, 0, 255), (255, 80, 0), (0, 200, 255)
_UNSEEN_GREY = 128


def draw_heights(top: HeightMap) -> np.ndarray:
    """Draws a height map, y of the map upwards.

    Returns:
        (h, w, 3) uint8 BGR: low is dark, high is bright, not seen is grey.
    """
    picture = height_colors(top.heights[::-1])
    # Enlarge by a whole number.
    factor = max(round(SETTINGS.width_px / picture.shape[1]), 1)
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)


def height_colors(heights: np.ndarray) -> np.ndarray:
    """Returns the (h, w, 3) uint8 BGR colours of (h, w) heights, m, as `draw_heights` has them."""
    measured = np.isfinite(heights)
    low, high = np.nanpercentile(heights, [0, 100]) if measured.any() else (0.0, 1.0)
    scaled = np.nan_to_num((heights - low) / max(high - low, 1e-9))
    picture = cv2.applyColorMap((255 * scaled).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    picture[~measured] = _UNSEEN_GREY
    return picture


def draw_labels(view: KeyView) -> np.ndarray:
    """Draws the labels of a key view that has colour.

    Returns:
        (h, w, 3) uint8 BGR: the picture with parts tinted blue and the container orange.
    """
    assert view.color is not None  # checked by the caller
    picture = view.color[..., ::-1].astype(np.float32)
    for label, tint in LABEL_TINTS.items():
        labelled = view.labels == label
        picture[labelled] = (1 - SETTINGS.tint_share) * picture[labelled] \
            + SETTINGS.tint_share * np.array(tint)
    return picture.astype(np.uint8)


def draw_container(view: KeyView, container: Container) -> np.ndarray:
    """Draws the fitted inner wall of a container that has rings into the key view.

    Returns:
        (h, w, 3) uint8 BGR, larger than the key view: rim red, floor blue, yellow lines between.
    """
    assert container.rings is not None  # checked by the caller
    scale = SETTINGS.container_scale
    # Take the colour image, or the label image where there is none.
    if view.color is not None:
        picture = np.ascontiguousarray(view.color[..., ::-1])
    else:
        grey = np.where(view.labels == UNSEEN, 0, view.labels * 100)
        picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)
    picture = cv2.resize(picture, None, fx=scale, fy=scale)
    # Project the rings from the floor up.
    rings = container.rings
    rings = rings[rings[:, 0, 2] >= container.floor_thickness_m]
    T_camera_container = geometry.inverse(view.T_world_camera) @ container.T_world_container
    pixels, _ = geometry.project(geometry.apply(T_camera_container, rings), view.intrinsics)
    # Draw some lines down the wall, then floor and rim over them.
    lines = np.round(scale * pixels + (scale - 1) / 2).astype(np.int32)  # (k, n, 2)
    for i in range(0, lines.shape[1], max(lines.shape[1] // SETTINGS.wall_lines, 1)):
        down = np.ascontiguousarray(lines[:, i])
        cv2.polylines(picture, [down], False, _YELLOW, 1, cv2.LINE_AA)
    for ring, color in ((lines[0], _BLUE), (lines[-1], _RED)):
        cv2.polylines(picture, [ring], True, color, 1, cv2.LINE_AA)
    return picture


def write_ply(path: Path, mesh: Mesh) -> None:
    """Writes a mesh as a binary PLY file, with colours where it has them.

    Raises:
        OSError: the file cannot be written.
    """
    # Lay out one vertex.
    fields = [("x", "<f4"), ("y", "<f4"), ("z", "<f4")]
    names = ["property float x", "property float y", "property float z"]
    if mesh.colors is not None:
        fields += [(name, "u1") for name in ("red", "green", "blue")]
        names += [f"property uchar {name}" for name in ("red", "green", "blue")]
    # Fill vertices and faces.
    vertices = np.zeros(len(mesh.vertices), fields)
    for i, name in enumerate("xyz"):
        vertices[name] = mesh.vertices[:, i]
    if mesh.colors is not None:
        for i, name in enumerate(("red", "green", "blue")):
            vertices[name] = mesh.colors[:, i]
    faces = np.zeros(len(mesh.triangles), [("n", "u1"), ("index", "<i4", 3)])
    faces["n"], faces["index"] = 3, mesh.triangles
    header = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}", *names,
              f"element face {len(faces)}", "property list uchar int vertex_indices",
              "end_header", ""]
    path.write_bytes("\n".join(header).encode() + vertices.tobytes() + faces.tobytes())
