# SPDX-License-Identifier: Apache-2.0
"""Parts at known poses on a level floor, as rays straight down see them."""

import numpy as np
import trimesh

from stack_counter import geometry
from stack_counter.sim.scenes.ray_caster import RayCaster
from stack_counter.types import HeightMap, Mesh
from stack_counter.visible_parts.decoding import PartsInMap

PITCH, SHAPE = 0.002, (90, 100)  # of the map: metres, rows and columns
NOISE_M = 0.0003


def bracket():
    """An L of arms of 40 and 30 mm, 12 mm wide and 8 mm thick, away from its file's origin."""
    long, short = (trimesh.creation.box(size) for size in ((0.04, 0.012, 0.008),
                                                            (0.012, 0.018, 0.008)))
    short.apply_translation((-0.014, 0.015, 0))
    return as_mesh(trimesh.util.concatenate([long, short]).apply_translation((0.05, 0, 0.01)))


def as_mesh(solid):
    return Mesh(solid.vertices.astype(np.float32), solid.faces.astype(np.int32))


def lying(mesh, rotation, xy):
    """T_map_part of a part so turned that touches the floor, its box's middle over (x, y)."""
    turned = mesh.vertices @ rotation.T
    low, high = turned.min(axis=0), turned.max(axis=0)
    return geometry.pose(rotation, np.array([*xy, 0]) - [*(low + high)[:2] / 2, low[2]])


def parts_on_floor(mesh, poses, T_world_map=np.eye(4), covers=(), noise=NOISE_M):
    """The surface of parts at (k, 4, 4) T_map_part, with other meshes over them, and who shows.

    Returns:
        Map, and the parts with equal scores and shares.
    """
    solids = [Mesh(geometry.apply(T, mesh.vertices).astype(np.float32), mesh.triangles)
              for T in poses] + list(covers)
    rows, cols = np.indices(SHAPE)
    xy = np.stack([cols + 0.5, rows + 0.5], axis=-1) * PITCH
    each = np.stack([RayCaster(solid).surface_heights(xy) for solid in solids])
    each = np.where(np.isfinite(each), each, 0)
    numbers = np.where(each.max(axis=0) > 0, each.argmax(axis=0), -1)
    numbers[numbers >= len(poses)] = -1
    heights = each.max(axis=0) + np.random.default_rng(0).normal(0, noise, SHAPE)
    found = PartsInMap(numbers.astype(np.int32), np.zeros((len(poses), 2)),
                       np.ones(len(poses)), np.ones(len(poses)))
    return HeightMap(T_world_map, PITCH, heights.astype(np.float32)), found
