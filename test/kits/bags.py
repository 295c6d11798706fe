# SPDX-License-Identifier: Apache-2.0
"""Recordings made in code: a filled bin seen by an arm, with every part open to damage."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from kits.analytic import Scene

from stack_counter.bag.writer import write_bag
from stack_counter.types import Intrinsics

FRAME = "camera_color_optical_frame"
CAMERA = Intrinsics(160, 120, 152.5, 152.5, 79.5, 59.5)


def picture(seed, size=(120, 160)):
    """(h, w, 3) uint8 with enough texture to count as sharp."""
    coarse = np.random.default_rng(seed).integers(0, 255, (size[0] // 8, size[1] // 8, 3))
    return np.kron(coarse, np.ones((8, 8, 1))).astype(np.uint8)


def bin_views(fill=0.05, count=6, **changes):
    """Small RGB-D views of a bin filled flat; `changes` go into every view."""
    scene = Scene().bin((0.2, 0.15, 0.1), 0.008, 0.008, fill, yaw=0.3)
    return [replace(view, color=picture(i), camera=FRAME, stamp_ns=(i + 1) * 10**9, **changes)
            for i, view in enumerate(scene.views(count, radius=0.45, camera=CAMERA))]


def bag(tmp_path, views=None, name="bag", **options):
    """Path of a written bag."""
    write_bag(tmp_path / name, bin_views() if views is None else views, **options)
    return tmp_path / name
