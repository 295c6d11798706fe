# SPDX-License-Identifier: Apache-2.0
"""Surfaces of one scene in pairs: as rays from above cast it, and as a reconstruction has it.

Both lie on the reconstruction's own grid, at the network's resolution.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.occupancy.maps import StackMaps, make_maps, stack_maps
from stack_counter.sim import RayCaster, Scene
from stack_counter.train.data.heights import SETTINGS as ARC_SETTINGS
from stack_counter.train.data.heights import count_views_of_cells
from stack_counter.types import StackVolume


@dataclass(frozen=True, eq=False)
class SurfacePair:
    """A scene's surface twice: (rows, cols) arrays, `PIXELS_PER_LENGTH` pixels a part length.

    Attributes:
        cast: float32 highest surface as rays from above cast it, part lengths.
        top: float32, the same as reconstructed.
        inner: float32 inner surface as reconstructed, part lengths.
        seen_share: float32 share of an arc's views that see each place of it as cast.
        valid: bool, where both are known.
        walled: the stack stands in a container.
        resolution_m: what the reconstruction resolves, metres.
        part_length_m: v**(1/3), metres.
        name: folder and index of the scene.
        family: of the part's shape.
    """

    cast: np.ndarray
    top: np.ndarray
    inner: np.ndarray
    seen_share: np.ndarray
    valid: np.ndarray
    walled: bool
    resolution_m: float
    part_length_m: float
    name: str
    family: str

    @property
    def resolution(self) -> float:
        """What the reconstruction resolves, part lengths."""
        return self.resolution_m / self.part_length_m

    def maps(self, top: np.ndarray) -> StackMaps:
        """Makes maps of one of the two surfaces, or of another on their grid."""
        return make_maps(np.where(self.valid, top, 0), np.where(self.valid, self.inner, 0),
                         self.valid, self.walled)


def make_pair(scene: Scene, volume: StackVolume, name: str) -> SurfacePair:
    """Casts rays on a scene where a reconstruction of it has its cells.

    Raises:
        ScanError: the reconstruction has no surface.
    """
    part_length = scene.truth.unit_volume ** (1 / 3)
    maps = stack_maps(volume, scene.truth.unit_volume)
    assert volume.top is not None  # or there would be no maps
    # World points of the cells' centres at the reconstructed height.
    T, spans = volume.top.T_world_map, np.array(volume.top.heights.shape) * volume.top.pitch
    rows, cols = maps.top.shape
    x, y = ((np.arange(n) + 0.5) * span / n for n, span in ((cols, spans[1]), (rows, spans[0])))
    at_surface = np.stack([*np.meshgrid(x, y), maps.top * part_length], axis=-1)
    points = geometry.apply(T, at_surface.reshape(-1, 3)).reshape(at_surface.shape)
    # Highest of the parts, the container's inner surface and the support plane.
    z = np.maximum(RayCaster(scene.parts_mesh()).surface_heights(points[..., :2]), 0)
    valid, inside = maps.valid.copy(), scene.container.inner_mesh()
    if inside is not None:
        inner = RayCaster(inside).surface_heights(points[..., :2])
        valid &= np.isfinite(inner)
        z = np.maximum(z, inner)
    cast = ((at_surface[..., 2] + z - points[..., 2]) / part_length).astype(np.float32)
    seen_by = count_views_of_cells(cast, valid, scene.container.rim_height_m / part_length,
                                   np.random.default_rng([scene.seed, scene.index]))
    return SurfacePair(
        cast, maps.top, maps.top - maps.height,
        (seen_by / ARC_SETTINGS.views).astype(np.float32), valid,
        volume.container.kind not in ("none", "hull"), volume.resolution_m, part_length, name,
        scene.shape.family)


def write_pairs(path: Path, pairs: list[SurfacePair]) -> None:
    """Writes pairs in one step."""
    arrays = {f"{i}_{key}": value for i, pair in enumerate(pairs)
              for key, value in vars(pair).items()}
    unfinished = path.with_suffix(".part")
    with open(unfinished, "wb") as file:
        np.savez_compressed(file, count=len(pairs), **arrays)
    unfinished.replace(path)


def read_pairs(folder: Path) -> list[SurfacePair]:
    """Reads all pairs of a folder, in the order of the files' names."""
    pairs = []
    for path in sorted(folder.glob("*.npz")):
        with np.load(path, allow_pickle=False) as file:
            for i in range(int(file["count"])):
                fields = {name: file[f"{i}_{name}"] for name in SurfacePair.__dataclass_fields__}
                pairs.append(SurfacePair(**{
                    name: value if value.ndim else value.item()
                    for name, value in fields.items()}))
    return pairs
