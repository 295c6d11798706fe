# SPDX-License-Identifier: Apache-2.0
"""What is known of a part's form beside v, as numbers that the gamma-network reads.

There are three levels: v alone, v and the outer dimensions, and a mesh. Lengths are in part
lengths, v**(1/3), as in the network's maps; v over the box of the outer dimensions is the
reciprocal of their product.
"""

from __future__ import annotations

import math

import cv2
import numpy as np

from stack_counter.types import KnownForm, KnownLevel, MeshMeasures

_SIZE_VALUES = 3  # logs of the outer dimensions, the largest first
_MESH_VALUES = 6  # logs of solidity, surface and 1 + genus, and of the radii of gyration
KNOWN_VALUES = _SIZE_VALUES + _MESH_VALUES + 2  # and whether size and mesh are known


def form_of_mesh(vertices: np.ndarray, faces: np.ndarray) -> KnownForm:
    """Measures a closed mesh.

    The box is the smallest that stands on a plane across one of the mesh's own axes or of its
    principal axes.

    Args:
        vertices: (n, 3) metres.
        faces: (m, 3) indices, counter-clockwise from outside.
    """
    from scipy.spatial import ConvexHull  # whoever counts measures no mesh

    vertices = np.asarray(vertices, float)
    a, b, c = (vertices[faces[:, i]] for i in range(3))
    normals = np.cross(b - a, c - a)
    # Sum volume, centre and second moments of the tetrahedra over the faces.
    volumes = np.einsum("ij,ij->i", a, normals) / 6
    volume = float(volumes.sum())
    corner_sum = a + b + c
    center = volumes @ corner_sum / 4 / volume
    second = np.einsum("t,ti,tj->ij", volumes, corner_sum, corner_sum) / 20
    for corner in (a, b, c):
        second += np.einsum("t,ti,tj->ij", volumes, corner, corner) / 20
    variances, axes = np.linalg.eigh(second / volume - np.outer(center, center))
    # Choose the smallest box.
    boxes = [_box_across(vertices, frame) for frame in _turned_frames(np.eye(3), axes)]
    x, y, z = sorted(min(boxes, key=math.prod), reverse=True)
    edges = 3 * len(faces) // 2
    genus = round(1 - (len(vertices) - edges + len(faces)) / 2)
    gx, gy, gz = np.sqrt(np.maximum(variances[::-1], 0)).tolist()
    solidity = min(1.0, volume / float(ConvexHull(vertices).volume))
    return KnownForm((x, y, z), MeshMeasures(
        solidity, float(np.linalg.norm(normals, axis=1).sum() / 2), max(genus, 0), (gx, gy, gz)))


def _turned_frames(*frames: np.ndarray) -> list[np.ndarray]:
    """(3, 3) frames whose last column is each of the columns of some frames in turn."""
    return [np.roll(frame, turn, axis=1) for frame in frames for turn in range(3)]


def _box_across(vertices: np.ndarray, frame: np.ndarray) -> list[float]:
    """Sides of the smallest box around points (n, 3) one of whose sides is a frame's last axis."""
    local = vertices @ frame
    scale = np.ptp(local, axis=0).max()
    _, sides, _ = cv2.minAreaRect((local[:, :2] / scale).astype(np.float32))
    return [float(np.ptp(local[:, 2])), *(float(side * scale) for side in sides)]


def known_values(form: KnownForm, unit_volume: float) -> np.ndarray:
    """(KNOWN_VALUES,) float32 that the network reads; zeros in the place of what is not known.

    Args:
        form: what is known.
        unit_volume: v, m3.
    """
    part_length, values = unit_volume ** (1 / 3), np.zeros(KNOWN_VALUES, np.float32)
    if form.outer_size_m is not None:
        values[:_SIZE_VALUES] = np.log(sorted(form.outer_size_m, reverse=True)) \
            - np.log(part_length)
        values[-2] = 1
        if (mesh := form.mesh) is not None:
            values[_SIZE_VALUES:-2] = np.log([
                mesh.solidity, mesh.surface_m2 / part_length**2, 1 + mesh.genus,
                *(g / part_length for g in mesh.gyration_m)])
            values[-1] = 1
    return values


def add_size_errors(values: np.ndarray, relative_std: float, random: np.random.Generator
                    ) -> np.ndarray:
    """Returns (KNOWN_VALUES,) values with outer dimensions as somebody may have measured them."""
    errors = np.zeros_like(values)
    errors[:_SIZE_VALUES] = random.normal(0, relative_std, _SIZE_VALUES)
    return values + errors


def hide_above(values: np.ndarray, level: KnownLevel) -> np.ndarray:
    """Returns (..., KNOWN_VALUES) values without what lies above a level of knowledge."""
    hidden = values.copy()
    if level < KnownLevel.MESH:
        hidden[..., _SIZE_VALUES:-2] = 0
        hidden[..., -1] = 0
    if level < KnownLevel.SIZE:
        hidden[..., :_SIZE_VALUES] = 0
        hidden[..., -2] = 0
    return hidden
