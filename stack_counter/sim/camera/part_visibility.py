# SPDX-License-Identifier: Apache-2.0
"""Which parts of a pile a camera sees, and how much of each."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from stack_counter.lean_open3d import o3c, o3d
from stack_counter.sim.camera.render import Renderer, camera_rays
from stack_counter.sim.scenes.scene import Scene
from stack_counter.types import Intrinsics

# Share of its outline from which a part counts as visible; chosen.
VISIBLE_SHARE = 0.1
_ROWS_AT_ONCE = 64  # of rays whose hits are listed: some ten of 40 bytes for each


@dataclass(frozen=True, eq=False)
class PartsInView:
    """The parts that one picture shows.

    Attributes:
        numbers: (h, w) int32 number of the part that each pixel shows; -1 where none is.
        shares: (n,) float64: which share of a part's outline in the picture is not hidden by
            other parts or the container, for each part of the scene; 0 for those outside.
    """

    numbers: np.ndarray
    shares: np.ndarray

    @property
    def visible(self) -> np.ndarray:
        """(k,) numbers of the parts that count as visible, those that show most first."""
        order = np.argsort(-self.shares, kind="stable")
        return order[self.shares[order] >= VISIBLE_SHARE]

    def boxes(self, parts: np.ndarray) -> np.ndarray:
        """(k, 4) float64 x0, y0, x1, y1: corners around the pixels that show each of (k,) parts.

        Pixels; the corners belong to the outermost pixels. NaN for a part that shows nowhere.
        """
        return np.array([_box_around(self.numbers == part) for part in parts]).reshape(-1, 4)

    def centers(self, parts: np.ndarray) -> np.ndarray:
        """(k, 2) float64 x, y: mean of the pixels that show each of (k,) parts."""
        return np.array([np.argwhere(self.numbers == part).mean(axis=0)[::-1]
                         for part in parts]).reshape(-1, 2)

    def cropped(self, rows: slice, cols: slice) -> PartsInView:
        """The same in a crop of the picture; shares stay those of the whole one."""
        return PartsInView(np.ascontiguousarray(self.numbers[rows, cols]), self.shares)


def find_parts_in_view(renderer: Renderer, scene: Scene, intrinsics: Intrinsics,
                       T_world_camera: np.ndarray) -> PartsInView:
    """Finds what a camera sees of each part of a scene that `renderer` was made of."""
    numbers = renderer.render_part_numbers(intrinsics, T_world_camera)
    count = len(scene.poses)
    shown = np.bincount(numbers[numbers >= 0], minlength=count)
    outline = _outline_pixels(scene, intrinsics, T_world_camera)
    return PartsInView(numbers, np.where(outline > 0, shown / np.maximum(outline, 1), 0.0))


def _outline_pixels(scene: Scene, intrinsics: Intrinsics, T_world_camera: np.ndarray
                    ) -> np.ndarray:
    """(n,) number of pixels that each part would take if nothing stood before it."""
    mesh, count = scene.parts_mesh(), len(scene.poses)
    pixels = np.zeros(count, np.int64)
    if not count:
        return pixels
    raycasting = o3d.t.geometry.RaycastingScene()
    raycasting.add_triangles(o3c.Tensor(mesh.vertices),
                             o3c.Tensor(mesh.triangles.astype(np.uint32)))
    rays = camera_rays(intrinsics, T_world_camera).astype(np.float32)
    for first in range(0, len(rays), _ROWS_AT_ONCE):
        some = np.ascontiguousarray(rays[first:first + _ROWS_AT_ONCE]).reshape(-1, 6)
        hits = raycasting.list_intersections(o3c.Tensor(some))
        part = hits["primitive_ids"].numpy().astype(np.int64) // len(scene.shape.faces)
        # A ray that meets a part twice is one pixel of it.
        once = np.unique(hits["ray_ids"].numpy().astype(np.int64) * count + part)
        pixels += np.bincount(once % count, minlength=count)
    return pixels


def _box_around(mask: np.ndarray) -> list[float]:
    rows, cols = np.nonzero(mask)
    if not len(rows):
        return [np.nan] * 4
    return [float(cols.min()), float(rows.min()), float(cols.max()), float(rows.max())]
