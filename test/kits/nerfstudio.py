# SPDX-License-Identifier: Apache-2.0
"""A small nerfstudio scene made in code, every key and file of it open to change."""

from __future__ import annotations

import json

import cv2
import numpy as np
from kits.bags import picture

from stack_counter import geometry

FLIP = np.diag([1.0, -1, -1, 1])
NAMES = ("f0", "f1", "f2")


def make_scene(folder, frame_keys=None, suffix=".png", remove=(), **changes):
    """Writes three pictures of 160x120 pixels and their transforms.json; returns the folder.

    Args:
        folder: a new one.
        frame_keys: keys of every frame; `{}` in a text stands for the picture's name.
        suffix: of the pictures as transforms.json names them; the files are PNG.
        remove: keys that transforms.json is to lack.
        changes: further keys of transforms.json.
    """
    (folder / "images").mkdir(parents=True)
    frames = []
    for i, name in enumerate(NAMES):
        optical = geometry.look_at(np.array([0.5 * np.cos(i), 0.5 * np.sin(i), 0.4]), np.zeros(3))
        cv2.imwrite(str(folder / f"images/{name}.png"), picture(i))
        keys = {key: value.format(name) if isinstance(value, str) else value
                for key, value in (frame_keys or {}).items()}
        frames.append({"file_path": f"images/{name}{suffix}",
                       "transform_matrix": (optical @ FLIP).tolist(), **keys})
    document = {"w": 160, "h": 120, "fl_x": 150.0, "fl_y": 151.0, "cx": 80.0, "cy": 60.0,
                "k1": 0.01, "k2": -0.02, "p1": 0.001, "p2": 0.002, "camera_model": "OPENCV",
                "frames": frames, **changes}
    (folder / "transforms.json").write_text(json.dumps(
        {key: value for key, value in document.items() if key not in remove}))
    return folder


def add_images(scene, folder, pixels, suffix=".png"):
    """Writes one image for each picture; of .npy files, the array itself."""
    (scene / folder).mkdir()
    for name in NAMES:
        path = scene / folder / f"{name}{suffix}"
        if suffix == ".npy":
            np.save(path, pixels)
        else:
            cv2.imwrite(str(path), pixels)
    return scene
