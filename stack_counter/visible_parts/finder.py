# SPDX-License-Identifier: Apache-2.0
"""Finds the parts that show in a reconstruction: maps, network, parts in the world.

The network reads what the gamma-network reads, lengths in parts, so that one network serves parts
of every size, and knows no CAD.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from stack_counter import geometry
from stack_counter.errors import ScanError, WeightsError
from stack_counter.files import read_weights, shipped_weights
from stack_counter.inference import NetworkSession
from stack_counter.occupancy.maps import StackMaps, network_channels, stack_maps
from stack_counter.types import HeightMap, Mesh, StackVolume, VisiblePart
from stack_counter.visible_parts.decoding import PartsInMap, decode_parts

SHIPPED = "visible_parts.safetensors"
FORMAT = "stack_counter visible parts 1"
STRIDE = 16  # pixels for a cell of the network's coarsest features: maps are padded to it


class VisiblePartFinder:
    """The network with the score from which a part is told.

    Attributes:
        poses: number of parts whose poses are found where the part's mesh is known.
    """

    def __init__(self, path: Path, poses: int = 0):
        """Loads the network of a file.

        Raises:
            WeightsError: the file is missing, not safetensors, of another format or not whole.
        """
        self.poses = poses
        file = read_weights(path, FORMAT)
        try:
            self._threshold = float(file.metadata["threshold"])
        except (KeyError, ValueError) as error:
            raise WeightsError(f"{path} names no threshold; expected a number: train it again"
                               ) from error
        self._session = NetworkSession(path, file.tensors)

    def find(self, volume: StackVolume, unit_volume: float, mesh: Mesh | None = None
             ) -> tuple[VisiblePart, ...] | None:
        """Finds the parts that show, the surest first.

        None where there is no surface to read, or the parts are too small beside it.

        Args:
            volume: the reconstruction.
            unit_volume: v, m3.
            mesh: of the part, in its own axes, metres, for poses; None where it is not known.
        """
        if volume.top is None:
            return None
        try:
            maps = stack_maps(volume, unit_volume)
        except ScanError:
            return None
        parts = self.find_in_maps(maps)
        part_length = unit_volume ** (1 / 3)
        placed = place_parts(parts, maps, volume.top, part_length)
        if mesh is None or not self.poses:
            return placed
        from stack_counter.visible_parts.poses import find_poses  # loads SciPy: seldom needed

        poses = find_poses(parts, self.poses, volume.top, mesh, part_length)
        return tuple(replace(part, pose=pose) for part, pose in zip(placed, poses))

    def find_in_maps(self, maps: StackMaps) -> PartsInMap:
        """Finds the parts that show in a stack's maps."""
        channels = pad_channels(network_channels(maps))
        output = self._session(maps=channels[None])[0][0]
        rows, cols = maps.valid.shape
        return decode_parts(output[:, :rows, :cols], maps.valid, self._threshold)


def make_finder(weights: str = "", poses: int = 0) -> VisiblePartFinder:
    """Returns what finds parts by the network of a file.

    Args:
        weights: of the file; empty: the shipped one.
        poses: number of parts whose poses are found where the part's mesh is known.

    Raises:
        WeightsError: it cannot be loaded.
    """
    return VisiblePartFinder(Path(weights) if weights else shipped_weights(SHIPPED), poses)


def pad_channels(channels: np.ndarray) -> np.ndarray:
    """(CHANNELS, rows, cols) with zeros, which are not valid, up to multiples of `STRIDE`."""
    _, rows, cols = channels.shape
    return np.pad(channels, ((0, 0), (0, -rows % STRIDE), (0, -cols % STRIDE)))


def place_parts(parts: PartsInMap, maps: StackMaps, top: HeightMap, part_length: float
                ) -> tuple[VisiblePart, ...]:
    """Places parts of a map in the world.

    Args:
        parts: as found in `maps`.
        maps: made of `top`.
        top: the surface.
        part_length: v**(1/3), metres.
    """
    # A pixel of the maps covers so many cells of the surface.
    cells = np.array(top.heights.shape) / maps.valid.shape
    shown = parts.numbers >= 0
    sums = np.bincount(parts.numbers[shown], maps.top[shown], len(parts.scores))
    heights = sums / np.bincount(parts.numbers[shown], minlength=len(parts.scores)) * part_length

    def place(pixels: np.ndarray, height: float) -> np.ndarray:
        local = np.full((len(pixels), 3), height)
        local[:, :2] = ((pixels + 0.5) * cells * top.pitch)[:, ::-1]
        return geometry.apply(top.T_world_map, local)

    return tuple(VisiblePart(place(parts.centers[i:i + 1], height)[0],
                             place(outline, height), float(parts.shares[i]),
                             float(parts.scores[i]))
                 for i, (height, outline) in enumerate(zip(heights, parts.outlines())))
