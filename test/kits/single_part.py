# SPDX-License-Identifier: Apache-2.0
"""Simulated scenes of a single part."""

import numpy as np

from stack_counter.sim import Scene
from stack_counter.sim.scenes.containers import ContainerShape
from stack_counter.sim.shapes import Shape

HEAP = ContainerShape("none", inner_size_m=(1.0, 1.0, 0.0))


def one_part(mesh, z, container=HEAP):
    """A scene of a single part above the middle of the container's bottom."""
    shape = Shape("test", np.asarray(mesh.vertices, float), np.asarray(mesh.faces, np.int32))
    return Scene(0, 0, shape, container, np.array([[0, 0, z, 0, 0, 0, 1.0]]))
