# SPDX-License-Identifier: Apache-2.0
"""Textures as functions of the place, and pictures of them, for tests that match pictures."""

from dataclasses import replace

import numpy as np
from kits.analytic import Scene

from stack_counter import geometry
from stack_counter.types import BACKGROUND, CONTAINER, PARTS, Intrinsics

CAMERA = Intrinsics(320, 240, 300.0, 300.0, 159.5, 119.5)


def wavy_texture(points, seed=3, waves=40):
    """Grey levels (...) float32 of (..., 3) points in metres: waves of 8 to 40 mm, no noise."""
    random = np.random.default_rng(seed)
    out = np.zeros(points.shape[:-1], np.float32)
    for _ in range(waves):
        way = random.normal(size=3)
        way *= 2 * np.pi / random.uniform(0.008, 0.04) / np.linalg.norm(way)
        out += np.sin(points @ way.astype(np.float32) + random.uniform(0, 2 * np.pi))
    return np.clip(127 + 18 * out, 0, 255)


def textured_views(scene, label, T_world_scene=np.eye(4), count=12, tilts=(12, 28, 42)):
    """Textured views of a scene without depth; `label` maps points of the scene to labels."""
    views = []
    for i, view in enumerate(scene.views(count, 0.5, (0, 0, 0.03), tilts=tilts, camera=CAMERA)):
        points = geometry.world_points(view)
        color = np.repeat(wavy_texture(points)[..., None], 3, axis=-1).astype(np.uint8)
        labels = np.where(points[..., 2] > 1e-4, label(points), BACKGROUND).astype(np.uint8)
        views.append(replace(view, depth=None, color=color, labels=labels,
                             camera="camera_color_optical_frame", stamp_ns=(i + 1) * 10**9,
                             T_world_camera=T_world_scene @ view.T_world_camera))
    return views


def closed_container_views(count=8):
    """Pictures of a textured block whose right end is labelled as container, as of a bag."""
    scene = Scene().box([0, 0, 0.03], (0.14, 0.1, 0.06))
    return textured_views(scene, lambda points: np.where(points[..., 0] > 0.04, CONTAINER, PARTS),
                          count=count)
