# SPDX-License-Identifier: Apache-2.0
"""Scenes of cubes that lie where they are put."""

import numpy as np
import trimesh

from stack_counter.sim import ContainerShape, Scene, shape_from_mesh

SIDE = 0.02  # of a cube, which is a part length, metres
_BOX = trimesh.creation.box((SIDE,) * 3)
_CUBE = shape_from_mesh(_BOX.vertices, _BOX.faces, "cube")


def cubes(*xyz, kind="none"):
    """A scene of cubes whose middles lie at (x, y, z) in sides, in a container or in none."""
    poses = np.array([[*(SIDE * np.array(place)), 0, 0, 0, 1] for place in xyz], float)
    size = (0.1, 0.1, 0.06) if kind != "none" else (0.1, 0.1, 0.0)
    walls = {"wall_thickness_m": 0.002, "floor_thickness_m": 0.002} if kind != "none" else {}
    T = np.eye(4)
    T[:3, 3] = 0.3, -0.2, 0
    return Scene(0, 0, _CUBE, ContainerShape(kind, T, size, **walls), poses)
