# SPDX-License-Identifier: Apache-2.0
"""Cameras around a table, markers and boards as they see them, and marks of points of it."""

import cv2
import numpy as np

from stack_counter import geometry
from stack_counter.pictures.structure_from_motion import Camera
from stack_counter.types import Intrinsics

CAMERA = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5)
UNIT = 0.4  # metres in the unit of the reconstructions here


def cameras(count=6, distortion=()):
    """Cameras by picture name, half a metre from the origin, in units of `UNIT` metres."""
    k = Intrinsics(640, 480, 600.0, 600.0, 319.5, 239.5, "plumb_bob", distortion or (0.0,) * 5)
    out = {}
    for i in range(count):
        angle = 2 * np.pi * i / count
        eye = np.array([0.35 * np.cos(angle), 0.35 * np.sin(angle), 0.35 + 0.02 * i])
        T = geometry.look_at(eye, np.zeros(3))
        out[f"p{i}.png"] = Camera(k, geometry.pose(T[:3, :3], T[:3, 3] / UNIT))
    return out


def marks(point, seen, noise=0.0, random=None):
    """Pixels of a point (3,), metres, by picture name; `noise`: their standard deviation."""
    out = {}
    for name, camera in seen.items():
        local = geometry.apply(geometry.inverse(camera.T_world_camera), np.asarray(point) / UNIT)
        pixel = cv2.projectPoints(local[None], np.zeros(3), np.zeros(3), camera.intrinsics.K,
                                  np.array(camera.intrinsics.distortion))[0].ravel()
        out[name] = tuple(pixel + (random.normal(0, noise, 2) if noise else 0))
    return out


def marks_text(point, seen):
    """The same as the end of a `--reference`."""
    return " ".join(f"{name}:{x:.2f},{y:.2f}" for name, (x, y) in marks(point, seen).items())


def pictures_of(drawing, size, seen):
    """Grey pictures by name of a flat drawing (rows, cols) that lies at the origin.

    Args:
        drawing: uint8; its first row is far in y, its columns go with x.
        size: its width and height, metres.
        seen: cameras by picture name.
    """
    rows, cols = drawing.shape
    corners = np.array([[-1, 1, 0], [1, 1, 0], [1, -1, 0], [-1, -1, 0]]) / 2 * [*size, 0]
    source = np.array([[0, 0], [cols, 0], [cols, rows], [0, rows]], np.float32) - 0.5
    out = {}
    for name, camera in seen.items():
        target = np.array([marks(corner, {name: camera})[name] for corner in corners], np.float32)
        H = cv2.getPerspectiveTransform(source, target)
        out[name] = cv2.warpPerspective(drawing, H, (640, 480), flags=cv2.INTER_AREA,
                                        borderValue=200)
    return out
