# SPDX-License-Identifier: Apache-2.0
"""Views of balls in a box in three colours, with their true labels and what a user would mark."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
from kits.analytic import CAMERA, Scene

from stack_counter.types import BACKGROUND, PARTS

SMALL = replace(CAMERA, width=200, height=150, fx=190.0, fy=190.0, cx=99.5, cy=74.5)
COLORS = np.array([[150, 130, 100], [40, 70, 150], [190, 110, 60]])  # plane, container, parts


@cache
def painted(count=4, depth=True, noise=0.001, bin_at=(0.0, 0.0)):
    """RGB-D views with true labels: noise and shading in the colours, `noise` metres in depth."""
    x, y = bin_at
    box = Scene(plane=False).bin((0.2, 0.15, 0.06), 0.008, 0.008, 0.0, x, y)
    balls = Scene(plane=False)
    for i in range(4):
        for j in range(3):
            balls.sphere((x - 0.075 + 0.05 * i, y - 0.05 + 0.05 * j, 0.03), 0.021)
    rings = [scene.views(count, 0.45, (x, y, 0.03), camera=SMALL)
             for scene in (Scene(), box, balls)]  # by label
    views = []
    for i, layers in enumerate(zip(*rings)):
        far = np.stack([np.where(v.depth > 0, v.depth, np.inf) for v in layers])
        labels = np.argmin(far, axis=0).astype(np.uint8)
        random = np.random.default_rng(i)
        shade = 1 + 0.1 * np.sin(np.arange(SMALL.width) / 25)[None, :, None]
        color = COLORS[labels] * shade + random.normal(0, 6, (*labels.shape, 3))
        z = far.min(axis=0) + random.normal(0, noise, labels.shape)
        views.append(replace(layers[0], color=np.clip(color, 0, 255).astype(np.uint8),
                             depth=z.astype(np.float32) if depth else None, labels=labels,
                             stamp_ns=(i + 1) * 10**9, camera="camera_color_optical_frame"))
    return views


def marks(labels, loose=4):
    """A loose box around each class, as a user draws it."""
    def around(mask):
        rows, cols = np.nonzero(mask)
        return [[int(cols.min()) - loose, int(rows.min()) - loose,
                 int(cols.max()) + loose, int(rows.max()) + loose]]

    return {"parts": {"boxes": around(labels == PARTS)},
            "container": {"boxes": around(labels != BACKGROUND)}}


def unlabelled(views):
    return [replace(view, labels=None) for view in views]
