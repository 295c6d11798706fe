# SPDX-License-Identifier: Apache-2.0
"""A row of equal bins side by side, full of the parts of a stored pile or empty."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from kits.analytic import CAMERA, Scene
from kits.bags import FRAME, picture

from stack_counter import geometry
from stack_counter.sim.scenes.shards import find_scene
from stack_counter.types import Intrinsics, Mesh

PILE = Path(__file__).parents[2] / "data" / "train-deep:353"  # 122 parts in a bin
HALF = Intrinsics(320, 240, 305.0, 305.0, 159.5, 119.5)  # a camera of half the pixels a side


class RowOfBins:
    """Bins along the world's x on the plane z = 0.

    Attributes:
        counts: number of parts in each bin.
        unit_volume: volume of one part, m3.
        centers: (n,) x of the bins' middles, m.
    """

    def __init__(self, full=(True, False, True, False), gap=0.002, lift=0.0):
        """Puts the pile into the bins that are full.

        Args:
            full: whether each of the bins is.
            gap: distance between outer walls, m.
            lift: height of a board, not much larger than the row, that all of them stand on, m.
        """
        pile = find_scene(str(PILE))
        self.unit_volume = pile.shape.unit_volume
        self.counts = [len(pile.poses) if is_full else 0 for is_full in full]
        # The bin's sides along x and y, its middle on the z axis.
        to_axes = geometry.inverse(pile.container.T_world_container)
        bin_mesh, parts = (_moved(mesh, to_axes) for mesh in
                           (pile.container.mesh(), pile.parts_mesh()))
        self._size = np.ptp(bin_mesh.vertices, axis=0)
        self.centers = (np.arange(len(full)) - (len(full) - 1) / 2) * (self._size[0] + gap)
        self.scene = Scene()
        for x, is_full in zip(self.centers, full):
            T = geometry.pose(np.eye(3), np.array([x, 0.0, lift]))
            for mesh in (bin_mesh, parts) if is_full else (bin_mesh,):
                self.scene.mesh(_moved(mesh, T))
        if lift:
            board = (np.ptp(self.centers) + self._size[0] + 0.05, self._size[1] + 0.05, lift)
            self.scene.box((0.0, 0.0, lift / 2), board)

    def regions(self, margin=0.0):
        """The setting `regions`: `bin_0`, `bin_1` ..., each a box round one bin, m."""
        width, depth = (round(float(s) + 2 * margin, 4) for s in self._size[:2])
        return {f"bin_{i}": {"center_m": [round(float(x), 4), 0.0, 0.09],
                             "size_m": [width, depth, 0.2]} for i, x in enumerate(self.centers)}

    def views(self, count=6, radius=0.75, camera=CAMERA, noise=0.0005):
        """RGB-D views from a ring above the row, 1 s apart from 1 s on."""
        views = self.scene.views(count, radius=radius, tilts=(12, 30), camera=camera, noise=noise)
        return [replace(view, color=picture(i, (camera.height, camera.width)), camera=FRAME,
                        stamp_ns=(i + 1) * 10**9) for i, view in enumerate(views)]


def _moved(mesh, T):
    """A mesh moved by a (4, 4) transform."""
    return Mesh(geometry.apply(T, mesh.vertices.astype(float)).astype(np.float32), mesh.triangles)
