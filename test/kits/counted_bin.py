# SPDX-License-Identifier: Apache-2.0
"""A count with all that a report shows, without a scan: a bin filled to a slope."""

from dataclasses import replace

import numpy as np
import trimesh

from stack_counter import geometry
from stack_counter.counting import make_count
from stack_counter.types import (
    CONTAINER,
    PARTS,
    Arrangement,
    CellFillingLevel,
    Container,
    FillingLevel,
    HeightMap,
    Intrinsics,
    KeyView,
    Mesh,
    OccupancyEstimate,
    RangeValue,
    Reason,
    StackVolume,
    ViewTally,
)

INNER = (0.30, 0.20, 0.10)  # m
FLOOR, PITCH = 0.004, 0.005  # m
SHAPE = (40, 60)  # rows and columns of the maps
# 1,000 scores: even quantiles of a standard normal distribution, as far as two digits tell.
SCORES = np.sort(np.random.default_rng(0).normal(size=100_000))[50::100]


def container():
    """The bin: 300 x 200 x 100 mm, its long side along x, in the middle of the world."""
    x, y = INNER[0] / 2, INNER[1] / 2
    rings = np.array([[[-x, -y, z], [x, -y, z], [x, y, z], [-x, y, z]]
                      for z in (0, FLOOR, FLOOR + INNER[2])])
    return Container("box", np.eye(4), INNER, 0.003, FLOOR, rings)


def fill():
    """(rows, cols) fill over the floor, m: from empty at the left to full at the right."""
    return np.tile((np.arange(SHAPE[1]) + 0.5) / SHAPE[1] * INNER[2], (SHAPE[0], 1))


def surface():
    """The slope as a coloured mesh: red at the left, blue at the right."""
    rows, cols = np.mgrid[:SHAPE[0], :SHAPE[1]]
    xyz = np.stack([(cols + 0.5) * PITCH - INNER[0] / 2, (rows + 0.5) * PITCH - INNER[1] / 2,
                    fill() + FLOOR], axis=-1).reshape(-1, 3)
    index = np.arange(rows.size).reshape(SHAPE)
    a, b, c, d = (index[:-1, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, :-1].ravel(),
                  index[1:, 1:].ravel())
    colors = np.where(xyz[:, :1] < 0, [200, 30, 30], [30, 30, 200]).astype(np.uint8)
    return Mesh(xyz.astype(np.float32), np.concatenate(
        [np.column_stack([a, b, d]), np.column_stack([a, d, c])]).astype(np.int32), colors)


def key_view():
    """The bin from straight above, with labels, colour and depth."""
    k = Intrinsics(160, 120, 200.0, 200.0, 79.5, 59.5)
    T = geometry.look_at(np.array([0, 0, 0.6]), np.zeros(3))
    labels = np.full((k.height, k.width), CONTAINER, np.uint8)
    labels[30:90, 30:130] = PARTS
    color = np.full((k.height, k.width, 3), 150, np.uint8)
    color[30:90, 30:130] = (180, 140, 90)
    return KeyView(1, k, T, int((labels == PARTS).sum()), labels,
                   np.full(labels.shape, 0.55, np.float32), color)


def filling_level(cells=8):
    """The level over a grid of cells of 37.5 x 40 mm, as the slope has it."""
    rows = round(cells * SHAPE[0] / SHAPE[1])
    width, length = INNER[0] / cells, INNER[1] / rows

    def cell(low, high, x, y, size):
        mean = (low + high) / 2
        return CellFillingLevel(
            size, (x, y, FLOOR + INNER[2]), RangeValue(100 * low, 100 * high, 100 * mean),
            RangeValue(*(INNER[2] * (1 - share) for share in (high, low, mean))), 0.93)

    grid = tuple(cell(col / cells, (col + 1) / cells, (col + 0.5) * width - INNER[0] / 2,
                      (row + 0.5) * length - INNER[1] / 2, (width, length))
                 for row in range(rows) for col in range(cells))
    return FillingLevel(cell(0.0, 1.0, 0.0, 0.0, INNER[:2]), grid, (cells, rows))


def counted_bin(reasons=(Reason.ONE_SIDE,), **changes):
    """A count of 100 parts: V 3 litres, gamma 0.4, v 12 cm3; `changes`: of its volume."""
    T = geometry.pose(np.eye(3), np.array([-INNER[0] / 2, -INNER[1] / 2, 0]))
    floor = np.full(SHAPE, FLOOR, np.float32)
    volume = StackVolume(**{**dict(
        stamp_ns=1_700_000_000 * 10**9, stack_volume=3e-3, stack_volume_std=6e-5,
        container=container(), fill_level=(0.0, 0.5, 1.0), coverage=0.93,
        top=HeightMap(T, PITCH, (fill() + FLOOR).astype(np.float32)),
        inner=HeightMap(T, PITCH, floor), key_view=key_view(),
        views=ViewTally(14, 11, {"blurred": 2, "no_tf": 1}), reasons=tuple(reasons),
        mesh=surface(), view_agreement_m=0.0012, seconds={"integrate": 1.5, "finish": 0.5},
        volume_parts={"seen": 2.4e-3, "filled": 4e-4, "wall": 2e-4},
        filling_level=filling_level()), **changes})
    estimate = OccupancyEstimate(0.4, 0.02, SCORES, "network", counted_scans=3,
                                 shares={"estimator": 0.25, "counted": 0.75})
    return replace(make_count(volume, 12e-6, estimate, 0.9), seconds=volume.seconds)


def plausible_parts(count=6, part=None):
    """So many cubes, or other parts, in a row on the bin's floor; three more stood out."""
    part = trimesh.creation.box((0.02, 0.02, 0.02)) if part is None else part
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, 0, 3] = np.linspace(-0.1, 0.1, count) if count > 1 else 0.0
    T[:, 2, 3] = FLOOR + 0.01
    return Arrangement(Mesh(np.asarray(part.vertices, np.float32),
                            np.asarray(part.faces, np.int32)), T, count + 3, 0.005, 4)
