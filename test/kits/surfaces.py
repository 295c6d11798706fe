# SPDX-License-Identifier: Apache-2.0
"""Surface maps and network inputs made of formulas."""

import numpy as np
import torch

from stack_counter.occupancy.maps import PIXELS_PER_LENGTH, TILE, make_maps, network_channels
from stack_counter.types import Container, HeightMap, StackVolume, ViewTally

SCORES = {"scores": np.linspace(-2, 2, 41)}


def stack_volume_of_heights(heights, floor=0.0, pitch=0.002, kind="box", key_view=None):
    top = None if heights is None else HeightMap(np.eye(4), pitch, np.asarray(heights, np.float32))
    inner = top and HeightMap(np.eye(4), pitch, np.full_like(top.heights, floor))
    return StackVolume(0, 1e-3, 0.0, Container(kind, np.eye(4)), (0, 0, 0), 1.0, top, inner,
                       key_view, ViewTally())


def sine_hills(scale, n=100):
    x = np.linspace(0, 1, n)
    return scale * (0.05 + 0.02 * np.sin(9 * x)[:, None] * np.cos(7 * x)[None])


def network_inputs(count, seed=0):
    """Surfaces of bumps of different sizes."""
    random = np.random.default_rng(seed)
    y, x = np.mgrid[:TILE, :TILE] / PIXELS_PER_LENGTH
    surfaces = [3 + np.sin(f * x + p) * np.cos(f * y) for f, p in
                zip(np.linspace(0.5, 3, count), random.uniform(0, 6, count))]
    return torch.from_numpy(np.stack([network_channels(make_maps(
        s.astype(np.float32), np.zeros_like(s, np.float32), np.ones_like(s, bool), True))
        for s in surfaces]))
