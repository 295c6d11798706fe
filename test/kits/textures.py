"""Textures as functions of the place, for tests that match pictures."""

import numpy as np


def wavy_texture(points, seed=3, waves=40):
    """Grey levels (...) float32 of (..., 3) points in metres: waves of 8 to 40 mm, no noise."""
    random = np.random.default_rng(seed)
    out = np.zeros(points.shape[:-1], np.float32)
    for _ in range(waves):
        way = random.normal(size=3)
        way *= 2 * np.pi / random.uniform(0.008, 0.04) / np.linalg.norm(way)
        out += np.sin(points @ way.astype(np.float32) + random.uniform(0, 2 * np.pi))
    return np.clip(127 + 18 * out, 0, 255)
