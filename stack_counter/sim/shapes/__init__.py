# SPDX-License-Identifier: Apache-2.0
"""Training parts: watertight single solids of families that robot cells handle.

Kept out, since they test how well the count carries over to unseen families: threaded fasteners,
bearings, T-fittings, crosses, bottles, pulleys, wheels, U-channels, Z-clips, knobs, toy bricks.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from manifold3d import Manifold

from stack_counter.sim.shapes import bent, free, machined, plain
from stack_counter.sim.shapes.shape import Shape, ShapeError, shape_from_mesh

__all__ = ["FAMILIES", "SIZES_M", "Shape", "ShapeError", "make_shape", "shape_from_mesh"]

FAMILIES: dict[str, Callable[[np.random.Generator], Manifold]] = {
    f.__name__: f for f in (
        plain.block, plain.plate, plain.rod, plain.tube, plain.ring, plain.washer, plain.capsule,
        plain.ball, plain.ellipsoid, plain.lens, plain.wedge, plain.cone, plain.prism,
        plain.pyramid, plain.dome, plain.pebble,
        machined.nut, machined.pin, machined.bracket, machined.gear, machined.hollow_box,
        machined.cup, machined.frame, machined.star, machined.flange, machined.notched,
        machined.perforated, machined.comb, machined.propeller, machined.dumbbell, machined.lever,
        machined.hinge,
        bent.elbow, bent.c_ring, bent.arch, bent.helix, bent.ribbon, bent.hook, bent.link,
        bent.crank, bent.saddle, bent.corrugated,
        free.blobs, free.csg, free.extruded, free.revolved, free.tetrapod, free.burr)}

# Range of the part sizes of simulated parts, metres; further draws of a generator that fails.
# Both chosen.
SIZES_M = (0.015, 0.045)
_RETRIES = 5


def make_shape(seed: int, family: str | None = None) -> Shape:
    """Draws a random part of 15 to 45 mm; the same for the same seed and family.

    Args:
        seed: seed of the random stream.
        family: a key of FAMILIES; None draws one.

    Raises:
        ShapeError: unknown family, or no draw gave a single watertight body.
    """
    random = np.random.default_rng([seed, 0x5A])
    if family is None:
        family = str(random.choice(list(FAMILIES)))
    if family not in FAMILIES:
        raise ShapeError(f"unknown family '{family}'; expected one of {sorted(FAMILIES)}")
    for _ in range(_RETRIES):
        try:
            return _draw_shape(random, seed, family)
        except ShapeError:
            continue  # the stream goes on with other numbers
    return _draw_shape(random, seed, family)


def _draw_shape(random: np.random.Generator, seed: int, family: str) -> Shape:
    """One draw of a family, scaled to a random size."""
    raw = FAMILIES[family](random).to_mesh64()
    size = random.uniform(*SIZES_M)
    return shape_from_mesh(raw.vert_properties[:, :3], raw.tri_verts, family, seed, size)
