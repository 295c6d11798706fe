# SPDX-License-Identifier: Apache-2.0
"""A small collection of real solids, made in code: two sources, three families."""

import numpy as np
import trimesh

from stack_counter.sim.shapes.extra.collection import Origin, solidify, write_collection

SOLIDS = {  # origin: mesh, millimetres of its unit
    Origin("a/brick", "BrickYard", "CC BY 4.0", "Brick", "Ann"):
        (trimesh.creation.box([20, 12, 8]), 1.0),
    Origin("a/slab", "BrickYard", "CC BY 4.0", "Slab", "Bob"):
        (trimesh.creation.box([3, 2, 0.6]), np.nan),
    Origin("b/pin", "ChipShop", "CC-BY-SA 4.0", "Pin_THT"):
        (trimesh.creation.cylinder(1, 4, sections=12), 0.5),
}


def make_collection(path):
    """Writes the collection and returns its solids."""
    solids = [solidify(mesh.copy(), origin, mm) for origin, (mesh, mm) in SOLIDS.items()]
    write_collection(path, solids)
    return solids
